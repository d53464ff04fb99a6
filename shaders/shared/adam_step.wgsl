// One Adam step over params[offset .. offset + len], counted in what the importing file calls `Value`; see
// src/ops/adam/mod.rs.
#import shared/linear_index

struct Params {
    offset: u32,
    len: u32,
    lr: f32,
    beta1: f32,
    beta2: f32,
    eps: f32,
    correction1: f32, // 1 - beta1^t
    correction2: f32, // 1 - beta2^t
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> values: array<Value>;
@group(0) @binding(2) var<storage, read> grads: array<Value>;
@group(0) @binding(3) var<storage, read_write> exp_avg: array<Value>;
@group(0) @binding(4) var<storage, read_write> exp_avg_sq: array<Value>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let at = linear_index(id, groups, 64u);
    if at >= params.len {
        return;
    }
    let i = params.offset + at;
    let g = grads[i];
    let m = params.beta1 * exp_avg[i] + (1.0 - params.beta1) * g;
    let v = params.beta2 * exp_avg_sq[i] + (1.0 - params.beta2) * g * g;
    exp_avg[i] = m;
    exp_avg_sq[i] = v;
    values[i] -= params.lr * (m / params.correction1) / (sqrt(v / params.correction2) + params.eps);
}
