// grads += the gradient of the acceleration penalty; one invocation a number; see src/ops/temporal/mod.rs.
#import shared/linear_index

struct Params {
    n_frames: u32,
    stride: u32,
    weight: f32,
    inverse_scale2: f32,
    max_change: f32,
    first: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> values: array<f32>; // [N, K]
@group(0) @binding(2) var<storage, read> expected: array<f32>; // [N, K]
@group(0) @binding(3) var<storage, read> spacing: array<f32>; // [N, 2]: beta, alpha
@group(0) @binding(4) var<storage, read_write> grads: array<f32>; // [N, K]

fn value(frame: u32, k: u32) -> f32 {
    return values[frame * params.stride + k];
}

fn beta(frame: u32) -> f32 {
    return spacing[2u * frame];
}

fn alpha(frame: u32) -> f32 {
    return spacing[2u * frame + 1u];
}

// The acceleration at an inner frame beyond the expected one; 0 where a change is a jump.
fn acceleration(frame: u32, k: u32) -> f32 {
    if frame == 0u || frame + 1u >= params.n_frames {
        return 0.0;
    }
    let before = value(frame, k) - value(frame - 1u, k);
    let after = value(frame + 1u, k) - value(frame, k);
    let beyond = alpha(frame) * after - beta(frame) * before - expected[frame * params.stride + k];
    return select(0.0, beyond, max(abs(before), abs(after)) <= params.max_change);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = linear_index(id, groups, 64u);
    let frame = i / params.stride;
    let k = i % params.stride;
    if frame >= params.n_frames || k < params.first {
        return;
    }
    var pull = -(alpha(frame) + beta(frame)) * acceleration(frame, k);
    if frame + 1u < params.n_frames {
        pull += beta(frame + 1u) * acceleration(frame + 1u, k);
    }
    if frame > 0u {
        pull += alpha(frame - 1u) * acceleration(frame - 1u, k);
    }
    grads[i] += 2.0 * params.weight * params.inverse_scale2 * pull;
}
