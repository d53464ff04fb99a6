// grad_points += Rᵀ grad_view; one invocation a point.
#import shared/linear_index
#import shared/pinhole

@group(0) @binding(0) var<uniform> params: Pinhole;
@group(0) @binding(1) var<storage, read> grad_view: array<f32>; // [P, 3]
@group(0) @binding(2) var<storage, read_write> grad_points: array<f32>; // [P, 3]

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = linear_index(id, groups, 64u);
    if i >= params.n_points {
        return;
    }
    let grad = params.view_from_world * vec3<f32>(grad_view[3u * i], grad_view[3u * i + 1u], grad_view[3u * i + 2u]);
    grad_points[3u * i] += grad.x;
    grad_points[3u * i + 1u] += grad.y;
    grad_points[3u * i + 2u] += grad.z;
}
