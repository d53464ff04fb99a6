// residuals = D_v − the mean of its neighbours' D, values = |residual|²; one invocation a vertex.
#import shared/linear_index

struct Params {
    n_vertices: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> starts: array<u32>; // [V + 1]
@group(0) @binding(2) var<storage, read> neighbours: array<u32>;
@group(0) @binding(3) var<storage, read> offsets: array<f32>; // [V, 3]
@group(0) @binding(4) var<storage, read_write> residuals: array<f32>; // [V, 3]
@group(0) @binding(5) var<storage, read_write> values: array<f32>; // [V]

fn offset_at(v: u32) -> vec3<f32> {
    return vec3<f32>(offsets[3u * v], offsets[3u * v + 1u], offsets[3u * v + 2u]);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let v = linear_index(id, groups, 64u);
    if v >= params.n_vertices {
        return;
    }
    let degree = starts[v + 1u] - starts[v];
    var residual = vec3<f32>();
    if degree > 0u {
        var sum = vec3<f32>();
        for (var at = starts[v]; at < starts[v + 1u]; at++) {
            sum += offset_at(neighbours[at]);
        }
        residual = offset_at(v) - sum / f32(degree);
    }
    residuals[3u * v] = residual.x;
    residuals[3u * v + 1u] = residual.y;
    residuals[3u * v + 2u] = residual.z;
    values[v] = dot(residual, residual);
}
