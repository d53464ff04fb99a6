// One listed pixel an invocation, k its place in the list: value = weight times the sum over the channels of |image - target|, and
// grad_image = lambda weight sign(image - target), both times the number of pixels that one of the sample stands for; zero for those that
// are not in the sample.
#import shared/linear_index
#import shared/rgb_difference
#import shared/rgb_weight
#import shared/sample

@group(0) @binding(0) var<uniform> params: RgbParams;
@group(0) @binding(1) var<storage, read> image: array<f32>;
@group(0) @binding(2) var<storage, read> seen: array<u32>;
@group(0) @binding(3) var<storage, read> pixel_index: array<u32>;
@group(0) @binding(4) var<storage, read> weights: array<f32>;
@group(0) @binding(5) var<storage, read_write> values: array<f32>;
@group(0) @binding(6) var<storage, read_write> grad_image: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let k = linear_index(id, groups, 64u);
    if k >= params.n_pixels {
        return;
    }
    let i = pixel_index[k];
    let off = difference_at(i);
    let stands_for = select(0.0, params.one_stands_for, is_sampled(i, params.seed, params.threshold));
    let weight = stands_for * weight_at(k);
    values[k] = weight * (abs(off.x) + abs(off.y) + abs(off.z));
    let g = params.lambda * weight * sign(off);
    grad_image[3u * i] = g.x;
    grad_image[3u * i + 1u] = g.y;
    grad_image[3u * i + 2u] = g.z;
}
