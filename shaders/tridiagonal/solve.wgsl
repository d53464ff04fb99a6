// x = (I + λL)⁻¹ b along chains of frames; one invocation an entry's axis. See src/ops/tridiagonal/mod.rs.
#import shared/linear_index

struct Params {
    n_frames: u32,
    per_frame: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> factors: array<f32>; // [N, P, 2]: 1 / pivot, λ / pivot where linked
@group(0) @binding(2) var<storage, read> right_side: array<f32>; // [N, P, 3]
@group(0) @binding(3) var<storage, read_write> x: array<f32>; // [N, P, 3]

@compute @workgroup_size(8)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let k = linear_index(id, groups, 8u);
    let stride = 3u * params.per_frame;
    if k >= stride {
        return;
    }
    var ratio = 0.0;
    var y = 0.0;
    for (var frame = 0u; frame < params.n_frames; frame++) {
        let at = frame * stride + k;
        y = right_side[at] + ratio * y;
        x[at] = y;
        ratio = factors[2u * (at / 3u) + 1u];
    }
    var after = 0.0;
    for (var left = params.n_frames; left > 0u; left--) {
        let at = (left - 1u) * stride + k;
        let factor = 2u * (at / 3u);
        after = factors[factor] * x[at] + factors[factor + 1u] * after;
        x[at] = after;
    }
}
