// One step of uniform Adam: as step.wgsl, with one second moment for all; see src/ops/adam/mod.rs.
#import shared/linear_index

struct Params {
    len: u32,
    lr: f32,
    beta1: f32,
    eps: f32,
    correction1: f32, // 1 - beta1^t
    correction2: f32, // 1 - beta2^t
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> values: array<f32>;
@group(0) @binding(2) var<storage, read> grads: array<f32>;
@group(0) @binding(3) var<storage, read_write> exp_avg: array<f32>;
@group(0) @binding(4) var<storage, read> exp_avg_sq: array<f32>; // [1]

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = linear_index(id, groups, 64u);
    if i >= params.len {
        return;
    }
    let g = grads[i];
    let m = params.beta1 * exp_avg[i] + (1.0 - params.beta1) * g;
    exp_avg[i] = m;
    values[i] -= params.lr * (m / params.correction1) / (sqrt(exp_avg_sq[0] / params.correction2) + params.eps);
}
