// One pixel an invocation: value = weight times the sum over the channels of |image - target|, and
// grad_image = lambda weight sign(image - target).
#import shared/linear_index
#import shared/target_pixel

#const WEIGHTED: bool = false

struct Params {
    n_pixels: u32,
    offset: u32,
    red: f32,
    green: f32,
    blue: f32,
    composite: f32,
    lambda: f32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> image: array<f32>;
@group(0) @binding(2) var<storage, read> seen: array<u32>;
@group(0) @binding(3) var<storage, read> weights: array<f32>;
@group(0) @binding(4) var<storage, read_write> values: array<f32>;
@group(0) @binding(5) var<storage, read_write> grad_image: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = linear_index(id, groups, 64u);
    if i >= params.n_pixels {
        return;
    }
    let wanted = target_rgb(params.offset + i, vec3<f32>(params.red, params.green, params.blue), params.composite);
    let off = vec3<f32>(image[3u * i], image[3u * i + 1u], image[3u * i + 2u]) - wanted;
    var weight = 1.0;
    if WEIGHTED {
        weight = weights[i];
    }
    values[i] = weight * (abs(off.x) + abs(off.y) + abs(off.z));
    let g = params.lambda * weight * sign(off);
    grad_image[3u * i] = g.x;
    grad_image[3u * i + 1u] = g.y;
    grad_image[3u * i + 2u] = g.z;
}
