// World to view space and to pixels; one invocation a point.
#import shared/linear_index
#import shared/pinhole

@group(0) @binding(0) var<uniform> params: Pinhole;
@group(0) @binding(1) var<storage, read> points: array<f32>; // [P, 3]
@group(0) @binding(2) var<storage, read_write> view: array<f32>; // [P, 3]
@group(0) @binding(3) var<storage, read_write> screen: array<f32>; // [P, 2]

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = linear_index(id, groups, 64u);
    if i >= params.n_points {
        return;
    }
    let p = vec4<f32>(points[3u * i], points[3u * i + 1u], points[3u * i + 2u], 1.0) * params.view_from_world;
    view[3u * i] = p.x;
    view[3u * i + 1u] = p.y;
    view[3u * i + 2u] = p.z;
    let z = max(p.z, params.z_min);
    screen[2u * i] = params.fx * p.x / z + params.cx;
    screen[2u * i + 1u] = params.fy * p.y / z + params.cy;
}
