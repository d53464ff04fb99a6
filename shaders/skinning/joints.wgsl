// The kinematic chain of one frame: local rotations, skinning transforms and posed joints. One workgroup, one lane a joint.
#import shared/rodrigues
#const N_JOINTS: u32 = 24u

struct Params {
    frame: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> poses: array<f32>; // [N, 24, 3]
@group(0) @binding(2) var<storage, read> transl: array<f32>; // [N, 3]
@group(0) @binding(3) var<storage, read> j_shaped: array<f32>; // [24, 3]
@group(0) @binding(4) var<storage, read> skeleton: array<u32>; // [24] parents, the root its own
@group(0) @binding(5) var<storage, read_write> rotations: array<f32>; // [24, 3, 3]
@group(0) @binding(6) var<storage, read_write> transforms: array<mat3x4<f32>>; // [24], the rows of 3×4 as columns
@group(0) @binding(7) var<storage, read_write> joints: array<f32>; // [24, 3]

var<workgroup> local_rotation: array<mat3x3<f32>, N_JOINTS>;
var<workgroup> local_translation: array<vec3<f32>, N_JOINTS>;

fn joint_at(j: u32) -> vec3<f32> {
    return vec3<f32>(j_shaped[3u * j], j_shaped[3u * j + 1u], j_shaped[3u * j + 2u]);
}

@compute @workgroup_size(32)
fn main(@builtin(local_invocation_index) j: u32) {
    if j < N_JOINTS {
        let at = params.frame * 3u * N_JOINTS + 3u * j;
        let rotation = rodrigues(vec3<f32>(poses[at], poses[at + 1u], poses[at + 2u]));
        local_rotation[j] = rotation;
        local_translation[j] = joint_at(j);
        if skeleton[j] != j {
            local_translation[j] -= joint_at(skeleton[j]);
        }
        for (var row = 0u; row < 3u; row++) {
            for (var column = 0u; column < 3u; column++) {
                rotations[9u * j + 3u * row + column] = rotation[column][row];
            }
        }
    }
    workgroupBarrier();
    if j >= N_JOINTS {
        return;
    }
    // Each lane walks its own way to the root: no lane waits for another.
    var rotation = local_rotation[j];
    var translation = local_translation[j];
    var at = j;
    while skeleton[at] != at {
        at = skeleton[at];
        translation = local_rotation[at] * translation + local_translation[at];
        rotation = local_rotation[at] * rotation;
    }
    let rows = transpose(rotation);
    let shift = translation - rotation * joint_at(j);
    transforms[j] = mat3x4<f32>(vec4<f32>(rows[0], shift.x), vec4<f32>(rows[1], shift.y), vec4<f32>(rows[2], shift.z));
    for (var axis = 0u; axis < 3u; axis++) {
        joints[3u * j + axis] = translation[axis] + transl[3u * params.frame + axis];
    }
}
