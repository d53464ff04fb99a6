// The last round's x without the fourth components.
#import shared/linear_index

struct Params {
    n_vertices: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> x_4: array<vec4<f32>>;     // [V]
@group(0) @binding(2) var<storage, read_write> x: array<f32>;       // [V, 3]

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = linear_index(id, groups, 64u);
    if i >= params.n_vertices {
        return;
    }
    let value = x_4[i];
    x[3u * i] = value.x;
    x[3u * i + 1u] = value.y;
    x[3u * i + 2u] = value.z;
}
