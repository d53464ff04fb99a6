// One pixel an invocation: image = one colour.
#import shared/linear_index

struct Params {
    n_pixels: u32,
    red: f32,
    green: f32,
    blue: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> image: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let pixel = linear_index(id, groups, 64u);
    if pixel >= params.n_pixels {
        return;
    }
    image[3u * pixel] = params.red;
    image[3u * pixel + 1u] = params.green;
    image[3u * pixel + 2u] = params.blue;
}
