// One Chebyshev step towards (I + λL) x = b; see src/ops/large_steps/mod.rs.
#import shared/linear_index

struct Params {
    n_vertices: u32,
    lambda: f32,
    momentum: f32, // factor on the last move
    gain: f32,     // factor on the scaled residual
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> starts: array<u32>;             // [V + 1]
@group(0) @binding(2) var<storage, read> neighbours: array<u32>;         // [starts[V]]
@group(0) @binding(3) var<storage, read> right_side: array<vec4<f32>>;   // [V]
@group(0) @binding(4) var<storage, read> x: array<vec4<f32>>;            // [V]
@group(0) @binding(5) var<storage, read_write> other: array<vec4<f32>>;  // [V]: x a round before, then the next one

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = linear_index(id, groups, 64u);
    if i >= params.n_vertices {
        return;
    }
    let start = starts[i];
    let end = starts[i + 1u];
    var around = vec4(0.0);
    for (var k = start; k < end; k++) {
        around += x[neighbours[k]];
    }
    let own = x[i];
    let diagonal = 1.0 + params.lambda * f32(end - start);
    let residual = (right_side[i] + params.lambda * around) / diagonal - own;
    other[i] = own + params.momentum * (own - other[i]) + params.gain * residual;
}
