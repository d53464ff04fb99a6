// Back through the kinematic chain of one frame: one workgroup, one lane a joint. src/ops/skinning/cpu.rs derives it.
#const N_JOINTS: u32 = 24u

struct Params {
    frame: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> j_shaped: array<f32>; // [24, 3]
@group(0) @binding(2) var<storage, read> skeleton: array<u32>; // [24] parents, then [24] bit sets of the subtrees
@group(0) @binding(3) var<storage, read> transforms: array<mat3x4<f32>>; // the rows of 3×4 as columns
@group(0) @binding(4) var<storage, read> grad_transforms: array<mat3x4<f32>>;
@group(0) @binding(5) var<storage, read> grad_joints: array<f32>; // [24, 3]
@group(0) @binding(6) var<storage, read_write> grad_rotations: array<f32>; // [24, 3, 3]
@group(0) @binding(7) var<storage, read_write> grad_j_shaped: array<f32>; // [24, 3]
@group(0) @binding(8) var<storage, read_write> grad_transl: array<f32>; // [N, 3]

var<workgroup> world_rotation: array<mat3x3<f32>, N_JOINTS>;
var<workgroup> moment: array<mat3x3<f32>, N_JOINTS>; // grad_rotation Rᵀ + grad_translation tᵀ of the world transforms
var<workgroup> grad_translation: array<vec3<f32>, N_JOINTS>;
var<workgroup> subtree_translation: array<vec3<f32>, N_JOINTS>;

fn joint_at(j: u32) -> vec3<f32> {
    return vec3<f32>(j_shaped[3u * j], j_shaped[3u * j + 1u], j_shaped[3u * j + 2u]);
}

fn rotation_of(rows: mat3x4<f32>) -> mat3x3<f32> {
    return transpose(mat3x3<f32>(rows[0].xyz, rows[1].xyz, rows[2].xyz));
}

fn translation_of(rows: mat3x4<f32>) -> vec3<f32> {
    return vec3<f32>(rows[0].w, rows[1].w, rows[2].w);
}

fn outer(a: vec3<f32>, b: vec3<f32>) -> mat3x3<f32> {
    return mat3x3<f32>(a * b.x, a * b.y, a * b.z);
}

@compute @workgroup_size(32)
fn main(@builtin(local_invocation_index) j: u32) {
    var translation = vec3<f32>();
    var grad_shift = vec3<f32>();
    if j < N_JOINTS {
        let rotation = rotation_of(transforms[j]);
        translation = translation_of(transforms[j]) + rotation * joint_at(j);
        grad_shift = translation_of(grad_transforms[j]);
        let grad_joint = vec3<f32>(grad_joints[3u * j], grad_joints[3u * j + 1u], grad_joints[3u * j + 2u]);
        let grad_rotation = rotation_of(grad_transforms[j]) - outer(grad_shift, joint_at(j));
        world_rotation[j] = rotation;
        grad_translation[j] = grad_shift + grad_joint;
        moment[j] = grad_rotation * transpose(rotation) + outer(grad_translation[j], translation);
    }
    workgroupBarrier();
    var subtree_moment = mat3x3<f32>();
    var sum = vec3<f32>();
    if j < N_JOINTS {
        for (var d = 0u; d < N_JOINTS; d++) {
            if ((skeleton[N_JOINTS + j] >> d) & 1u) == 1u {
                subtree_moment += moment[d];
                sum += grad_translation[d];
            }
        }
        subtree_translation[j] = sum;
    }
    workgroupBarrier();
    if j >= N_JOINTS {
        return;
    }
    let parent = skeleton[j];
    var to_parent = mat3x3<f32>(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
    if parent != j {
        to_parent = transpose(world_rotation[parent]);
    }
    let grad = to_parent * (subtree_moment - outer(sum, translation)) * world_rotation[j];
    for (var row = 0u; row < 3u; row++) {
        for (var column = 0u; column < 3u; column++) {
            grad_rotations[9u * j + 3u * row + column] = grad[column][row];
        }
    }
    var children = grad_shift;
    for (var c = 0u; c < N_JOINTS; c++) {
        if skeleton[c] == j && c != j {
            children += subtree_translation[c];
        }
    }
    let grad_joint = to_parent * sum - transpose(world_rotation[j]) * children;
    for (var axis = 0u; axis < 3u; axis++) {
        grad_j_shaped[3u * j + axis] += grad_joint[axis];
        if parent == j {
            // The root's subtree is the body; a vertex's weights sum to 1, so nothing of its gradient is missing.
            grad_transl[3u * params.frame + axis] += sum[axis];
        }
    }
}
