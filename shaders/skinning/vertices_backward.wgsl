// grad_v_posed = (Σ_k w_k A_k)ᵀ grad_vertices, kept and added to grad_v_deformed; one invocation a vertex.
#import shared/linear_index

struct Params {
    n_vertices: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> lbs_joints: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read> lbs_weights: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> transforms: array<mat3x4<f32>>; // the rows of 3×4 as columns
@group(0) @binding(4) var<storage, read> grad_vertices: array<f32>;
@group(0) @binding(5) var<storage, read_write> grad_v_posed: array<f32>;
@group(0) @binding(6) var<storage, read_write> grad_v_deformed: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let v = linear_index(id, groups, 64u);
    if v >= params.n_vertices {
        return;
    }
    let j = lbs_joints[v];
    let w = lbs_weights[v];
    let blend = w.x * transforms[j.x] + w.y * transforms[j.y] + w.z * transforms[j.z] + w.w * transforms[j.w];
    let g = vec3<f32>(grad_vertices[3u * v], grad_vertices[3u * v + 1u], grad_vertices[3u * v + 2u]);
    let grad = blend * g;
    for (var axis = 0u; axis < 3u; axis++) {
        grad_v_posed[3u * v + axis] = grad[axis];
        grad_v_deformed[3u * v + axis] += grad[axis];
    }
}
