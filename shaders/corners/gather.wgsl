// grad_view[v] += sum of grad_corners over the corners of v; see src/ops/corners.rs.
#import shared/linear_index

struct Params {
    n_vertices: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> starts: array<u32>;
@group(0) @binding(2) var<storage, read> corners: array<u32>;
@group(0) @binding(3) var<storage, read> grad_corners: array<f32>;
@group(0) @binding(4) var<storage, read_write> grad_view: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let v = linear_index(id, groups, 64u);
    if v >= params.n_vertices {
        return;
    }
    var sum = vec3<f32>(0.0);
    let end = starts[v + 1u];
    for (var i = starts[v]; i < end; i++) {
        let c = 3u * corners[i];
        sum += vec3<f32>(grad_corners[c], grad_corners[c + 1u], grad_corners[c + 2u]);
    }
    grad_view[3u * v] += sum.x;
    grad_view[3u * v + 1u] += sum.y;
    grad_view[3u * v + 2u] += sum.z;
}
