// One Chebyshev step towards (I + λL) x = b; see src/ops/large_steps/mod.rs.
#import shared/linear_index

struct Params {
    n_vertices: u32,
    lambda: f32,
    momentum: f32, // factor on the last move
    gain: f32,     // factor on the scaled residual
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> starts: array<u32>;         // [V + 1]
@group(0) @binding(2) var<storage, read> neighbours: array<u32>;     // [starts[V]]
@group(0) @binding(3) var<storage, read> right_side: array<f32>;     // [V, 3]
@group(0) @binding(4) var<storage, read> x: array<f32>;              // [V, 3]
@group(0) @binding(5) var<storage, read_write> last_move: array<f32>; // [V, 3]
@group(0) @binding(6) var<storage, read_write> x_next: array<f32>;   // [V, 3]

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = linear_index(id, groups, 64u);
    if i >= params.n_vertices {
        return;
    }
    let own = vec3(x[3u * i], x[3u * i + 1u], x[3u * i + 2u]);
    let b = vec3(right_side[3u * i], right_side[3u * i + 1u], right_side[3u * i + 2u]);
    let degree = f32(starts[i + 1u] - starts[i]);
    var around = vec3(0.0);
    for (var k = starts[i]; k < starts[i + 1u]; k++) {
        let j = neighbours[k];
        around += vec3(x[3u * j], x[3u * j + 1u], x[3u * j + 2u]);
    }
    let diagonal = 1.0 + params.lambda * degree;
    let residual = (b + params.lambda * around) / diagonal - own;
    let last = vec3(last_move[3u * i], last_move[3u * i + 1u], last_move[3u * i + 2u]);
    let move_ = params.momentum * last + params.gain * residual;
    last_move[3u * i] = move_.x;
    last_move[3u * i + 1u] = move_.y;
    last_move[3u * i + 2u] = move_.z;
    let next = own + move_;
    x_next[3u * i] = next.x;
    x_next[3u * i + 1u] = next.y;
    x_next[3u * i + 2u] = next.z;
}
