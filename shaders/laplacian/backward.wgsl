// grad_offsets += 2λ (r_v − Σ_{n∈N(v)} r_n / deg n); one invocation a vertex.
#import shared/linear_index

struct Params {
    n_vertices: u32,
    weight: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> starts: array<u32>; // [V + 1]
@group(0) @binding(2) var<storage, read> neighbours: array<u32>;
@group(0) @binding(3) var<storage, read> residuals: array<f32>; // [V, 3]
@group(0) @binding(4) var<storage, read_write> grad_offsets: array<f32>; // [V, 3]

fn residual_at(v: u32) -> vec3<f32> {
    return vec3<f32>(residuals[3u * v], residuals[3u * v + 1u], residuals[3u * v + 2u]);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let v = linear_index(id, groups, 64u);
    if v >= params.n_vertices {
        return;
    }
    var grad = residual_at(v);
    for (var at = starts[v]; at < starts[v + 1u]; at++) {
        let n = neighbours[at];
        grad -= residual_at(n) / f32(starts[n + 1u] - starts[n]);
    }
    grad *= 2.0 * params.weight;
    grad_offsets[3u * v] += grad.x;
    grad_offsets[3u * v + 1u] += grad.y;
    grad_offsets[3u * v + 2u] += grad.z;
}
