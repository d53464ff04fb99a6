// One diffusion step over a mesh: out_i = in_i + sum_j w_ij (in_j - in_i); see src/ops/diffuse/mod.rs.
#import shared/linear_index

struct Params {
    n_vertices: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> starts: array<u32>;      // [V + 1]
@group(0) @binding(2) var<storage, read> neighbours: array<u32>;  // [starts[V]]
@group(0) @binding(3) var<storage, read> values: array<f32>;      // [V, 3]
@group(0) @binding(4) var<storage, read_write> moved: array<f32>; // [V, 3]

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = linear_index(id, groups, 64u);
    if i >= params.n_vertices {
        return;
    }
    let own = vec3(values[3u * i], values[3u * i + 1u], values[3u * i + 2u]);
    let degree = starts[i + 1u] - starts[i];
    var change = vec3(0.0);
    for (var k = starts[i]; k < starts[i + 1u]; k++) {
        let j = neighbours[k];
        let weight = 0.5 / f32(max(degree, starts[j + 1u] - starts[j]));
        change += weight * (vec3(values[3u * j], values[3u * j + 1u], values[3u * j + 2u]) - own);
    }
    let result = own + change;
    moved[3u * i] = result.x;
    moved[3u * i + 1u] = result.y;
    moved[3u * i + 2u] = result.z;
}
