// One pixel an invocation: with I and U the sums, d(1 - I/U)/dalpha = (I (1 - S) - U S) / U^2.
#import shared/linear_index
#import shared/target_pixel

struct Params {
    n_pixels: u32,
    offset: u32,
    lambda: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> sums: array<f32>;
@group(0) @binding(2) var<storage, read> seen: array<u32>;
@group(0) @binding(3) var<storage, read_write> grad_alpha: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = linear_index(id, groups, 64u);
    if i >= params.n_pixels || sums[1] <= 0.0 {
        return;
    }
    let s = target_mask(params.offset + i);
    grad_alpha[i] += params.lambda * (sums[0] / sums[1] * (1.0 - s) - s) / sums[1];
}
