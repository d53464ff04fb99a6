// grad_poses of one frame from the gradients by its local rotations; one workgroup, one lane a joint.
#import shared/rodrigues
#const N_JOINTS: u32 = 24u

struct Params {
    frame: u32, // of poses
    grad_frame: u32, // of grad_poses
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> poses: array<f32>; // [N, 24, 3]
@group(0) @binding(2) var<storage, read> grad_rotations: array<f32>; // [24, 3, 3]
@group(0) @binding(3) var<storage, read_write> grad_poses: array<f32>; // [N, 24, 3]

@compute @workgroup_size(32)
fn main(@builtin(local_invocation_index) j: u32) {
    if j >= N_JOINTS {
        return;
    }
    var grad: mat3x3<f32>;
    for (var row = 0u; row < 3u; row++) {
        for (var column = 0u; column < 3u; column++) {
            grad[column][row] = grad_rotations[9u * j + 3u * row + column];
        }
    }
    let at = params.frame * 3u * N_JOINTS + 3u * j;
    let grad_theta = rodrigues_backward(vec3<f32>(poses[at], poses[at + 1u], poses[at + 2u]), grad);
    for (var axis = 0u; axis < 3u; axis++) {
        grad_poses[(params.grad_frame * N_JOINTS + j) * 3u + axis] += grad_theta[axis];
    }
}
