// grad_points += the gradient through the pixels; one invocation a point. Points nearer than z_min feel no pull along z.
#import shared/linear_index
#import shared/pinhole

@group(0) @binding(0) var<uniform> params: Pinhole;
@group(0) @binding(1) var<storage, read> points: array<f32>; // [P, 3]
@group(0) @binding(2) var<storage, read> grad_screen: array<f32>; // [P, 2]
@group(0) @binding(3) var<storage, read_write> grad_points: array<f32>; // [P, 3]

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = linear_index(id, groups, 64u);
    if i >= params.n_points {
        return;
    }
    let p = vec4<f32>(points[3u * i], points[3u * i + 1u], points[3u * i + 2u], 1.0) * params.view_from_world;
    let z = max(p.z, params.z_min);
    let x = params.fx * grad_screen[2u * i] / z;
    let y = params.fy * grad_screen[2u * i + 1u] / z;
    let depth = select(0.0, -(x * p.x + y * p.y) / z, p.z > params.z_min);
    let grad = params.view_from_world * vec3<f32>(x, y, depth);
    grad_points[3u * i] += grad.x;
    grad_points[3u * i + 1u] += grad.y;
    grad_points[3u * i + 2u] += grad.z;
}
