// The first Chebyshev step towards (I + λL) x = b, from x = 0; see src/ops/large_steps/mod.rs.
#import shared/linear_index

struct Params {
    n_vertices: u32,
    lambda: f32,
    gain: f32, // factor on the scaled residual
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> starts: array<u32>;                    // [V + 1]
@group(0) @binding(2) var<storage, read> right_side: array<f32>;                // [V, 3]
@group(0) @binding(3) var<storage, read_write> right_side_4: array<vec4<f32>>;  // [V]
@group(0) @binding(4) var<storage, read_write> before: array<vec4<f32>>;        // [V]: x of round 0
@group(0) @binding(5) var<storage, read_write> x: array<vec4<f32>>;             // [V]: x of round 1

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = linear_index(id, groups, 64u);
    if i >= params.n_vertices {
        return;
    }
    let b = vec4(right_side[3u * i], right_side[3u * i + 1u], right_side[3u * i + 2u], 0.0);
    let degree = f32(starts[i + 1u] - starts[i]);
    right_side_4[i] = b;
    before[i] = vec4(0.0);
    x[i] = params.gain * b / (1.0 + params.lambda * degree);
}
