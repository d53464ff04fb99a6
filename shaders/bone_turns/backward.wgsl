// grad_turns += the gradient by the turns of bones in space, from that by the poses; one invocation a frame. See
// src/ops/bone_turns/mod.rs.
#import shared/linear_index
#import shared/rotation_vector
#const N_JOINTS: u32 = 24u

struct Params {
    n_frames: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> skeleton: array<u32>; // [24, 2]: parent, the root its own; whether it turns in space
@group(0) @binding(2) var<storage, read> turns: array<f32>; // [N, 24, 3]
@group(0) @binding(3) var<storage, read> poses: array<f32>; // [N, 24, 3]
@group(0) @binding(4) var<storage, read> grad_poses: array<f32>; // [N, 24, 3]
@group(0) @binding(5) var<storage, read_write> grad_turns: array<f32>; // [N, 24, 3]

@compute @workgroup_size(8)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let frame = linear_index(id, groups, 8u);
    if frame >= params.n_frames {
        return;
    }
    // By a turn of each joint's orientation from the right.
    var by_orientation: array<vec3<f32>, N_JOINTS>;
    for (var left = N_JOINTS; left > 0u; left--) {
        let j = left - 1u;
        let at = 3u * (frame * N_JOINTS + j);
        let turn = vec3<f32>(turns[at], turns[at + 1u], turns[at + 2u]);
        let pose = vec3<f32>(poses[at], poses[at + 1u], poses[at + 2u]);
        let gradient = vec3<f32>(grad_poses[at], grad_poses[at + 1u], grad_poses[at + 2u]);
        var handed_on = by_orientation[j];
        var by_own = gradient + by_vector(pose, handed_on);
        if skeleton[2u * j + 1u] != 0u {
            let torque = by_turn(pose, gradient);
            by_own = by_vector(turn, handed_on + torque);
            handed_on = -torque;
        }
        grad_turns[at] += by_own.x;
        grad_turns[at + 1u] += by_own.y;
        grad_turns[at + 2u] += by_own.z;
        let parent = skeleton[2u * j];
        if parent != j {
            by_orientation[parent] += rotated(quaternion(pose), handed_on);
        }
    }
}
