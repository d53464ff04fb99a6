// One pixel an invocation: weight times the sum over the channels of |image - target|.
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
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> image: array<f32>;
@group(0) @binding(2) var<storage, read> seen: array<u32>;
@group(0) @binding(3) var<storage, read> weights: array<f32>;
@group(0) @binding(4) var<storage, read_write> values: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = linear_index(id, groups, 64u);
    if i >= params.n_pixels {
        return;
    }
    let wanted = target_rgb(params.offset + i, vec3<f32>(params.red, params.green, params.blue), params.composite);
    let off = abs(vec3<f32>(image[3u * i], image[3u * i + 1u], image[3u * i + 2u]) - wanted);
    var value = off.x + off.y + off.z;
    if WEIGHTED {
        value *= weights[i];
    }
    values[i] = value;
}
