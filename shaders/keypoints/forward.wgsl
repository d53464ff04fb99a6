// losses[slot] += Σ c r² / (1 + r²/ρ²), r = |screen − target|, for the keypoints of one frame. One workgroup.
#import shared/workgroup_sum

struct Params {
    n_keypoints: u32,
    frame: u32,
    inverse_rho2: f32, // 1/ρ², 0 for plain squares
    slot: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> screen: array<f32>; // [K, 2]
@group(0) @binding(2) var<storage, read> targets: array<f32>; // [N, K, 3]: x, y, confidence
@group(0) @binding(3) var<storage, read_write> losses: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) lane: u32) {
    var sum = 0.0;
    for (var k = lane; k < params.n_keypoints; k += 256u) {
        let at = 3u * (params.frame * params.n_keypoints + k);
        let confidence = targets[at + 2u];
        // A keypoint that was not seen may hold anything, NaN too.
        if confidence > 0.0 {
            let d = vec2<f32>(screen[2u * k] - targets[at], screen[2u * k + 1u] - targets[at + 1u]);
            let r2 = dot(d, d);
            sum += confidence * r2 / (1.0 + r2 * params.inverse_rho2);
        }
    }
    let total = workgroup_sum(lane, sum);
    if lane == 0u {
        losses[params.slot] += total;
    }
}
