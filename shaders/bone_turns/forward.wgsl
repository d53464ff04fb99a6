// Poses from the turns of bones in space; one invocation a frame. See src/ops/bone_turns/mod.rs.
#import shared/linear_index
#import shared/rotation_vector
#const N_JOINTS: u32 = 24u

struct Params {
    n_frames: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> skeleton: array<u32>; // [24, 2]: parent, the root its own; whether it turns in space
@group(0) @binding(2) var<storage, read> start: array<f32>; // [N, 24, 3]
@group(0) @binding(3) var<storage, read> began: array<vec4<f32>>; // [N, 24]: orientations in space at the start
@group(0) @binding(4) var<storage, read> turns: array<f32>; // [N, 24, 3]
@group(0) @binding(5) var<storage, read_write> poses: array<f32>; // [N, 24, 3]

@compute @workgroup_size(8)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let frame = linear_index(id, groups, 8u);
    if frame >= params.n_frames {
        return;
    }
    var orientations: array<vec4<f32>, N_JOINTS>;
    for (var j = 0u; j < N_JOINTS; j++) {
        let joint = frame * N_JOINTS + j;
        let at = 3u * joint;
        let from_start = vec3<f32>(start[at], start[at + 1u], start[at + 2u]);
        let turn = vec3<f32>(turns[at], turns[at + 1u], turns[at + 2u]);
        let parent = skeleton[2u * j];
        var above = vec4<f32>(0.0, 0.0, 0.0, 1.0);
        if parent != j {
            above = orientations[parent];
        }
        var pose = from_start + turn;
        if skeleton[2u * j + 1u] != 0u {
            orientations[j] = product_of(began[joint], quaternion(turn));
            pose = rotation_vector(product_of(inverse_of(above), orientations[j]), quaternion(from_start));
        } else {
            orientations[j] = product_of(above, quaternion(pose));
        }
        poses[at] = pose.x;
        poses[at + 1u] = pose.y;
        poses[at + 2u] = pose.z;
    }
}
