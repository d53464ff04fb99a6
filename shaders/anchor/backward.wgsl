// grads += the gradient of the pull to the start; one invocation a number; see src/ops/anchor/mod.rs.
#import shared/linear_index

struct Params {
    len: u32,
    stride: u32,
    weight: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> values: array<f32>;      // [N, K]
@group(0) @binding(2) var<storage, read> start: array<f32>;       // [N, K]
@group(0) @binding(3) var<storage, read> factors: array<f32>;     // [K]
@group(0) @binding(4) var<storage, read_write> grads: array<f32>; // [N, K]

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = linear_index(id, groups, 64u);
    if i >= params.len {
        return;
    }
    grads[i] += params.weight * factors[i % params.stride] * (values[i] - start[i]);
}
