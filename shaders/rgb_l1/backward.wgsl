// One pixel an invocation: grad_image += lambda weight sign(image - target).
#import shared/linear_index
#import shared/rgb_difference
#import shared/rgb_weight

@group(0) @binding(0) var<uniform> params: RgbParams;
@group(0) @binding(1) var<storage, read> image: array<f32>;
@group(0) @binding(2) var<storage, read> seen: array<u32>;
@group(0) @binding(3) var<storage, read> weights: array<f32>;
@group(0) @binding(4) var<storage, read_write> grad_image: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = linear_index(id, groups, 64u);
    if i >= params.n_pixels {
        return;
    }
    let g = params.lambda * weight_at(i) * sign(difference_at(i));
    grad_image[3u * i] += g.x;
    grad_image[3u * i + 1u] += g.y;
    grad_image[3u * i + 2u] += g.z;
}
