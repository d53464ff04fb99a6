// grad_screen += 2λ c (screen − target) / (1 + r²/ρ²)²; one invocation a keypoint.
struct Params {
    n_keypoints: u32,
    frame: u32,
    inverse_rho2: f32, // 1/ρ², 0 for plain squares
    weight: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> screen: array<f32>; // [K, 2]
@group(0) @binding(2) var<storage, read> targets: array<f32>; // [N, K, 3]: x, y, confidence
@group(0) @binding(3) var<storage, read_write> grad_screen: array<f32>; // [K, 2]

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let k = id.x;
    if k >= params.n_keypoints {
        return;
    }
    let at = 3u * (params.frame * params.n_keypoints + k);
    let confidence = targets[at + 2u];
    if !(confidence > 0.0) {
        return;
    }
    let d = vec2<f32>(screen[2u * k] - targets[at], screen[2u * k + 1u] - targets[at + 1u]);
    let damping = 1.0 + dot(d, d) * params.inverse_rho2;
    let grad = (2.0 * params.weight * confidence / (damping * damping)) * d;
    grad_screen[2u * k] += grad.x;
    grad_screen[2u * k + 1u] += grad.y;
}
