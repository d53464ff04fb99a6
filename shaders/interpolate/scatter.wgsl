// image[pixel] = rgb[k] where the list has the pixel at place k, the background elsewhere.
#import shared/linear_index
#import shared/listed

struct Params {
    background: vec3<f32>,
    n_pixels: u32,
    capacity: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> masks: array<u32>;
@group(0) @binding(2) var<storage, read> firsts: array<u32>;
@group(0) @binding(3) var<storage, read> rgb: array<f32>;
@group(0) @binding(4) var<storage, read_write> image: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = linear_index(id, groups, 64u);
    if i >= params.n_pixels {
        return;
    }
    var color = params.background;
    let mask = masks[i / BLOCK];
    if is_listed(mask, i) {
        let k = place_of(mask, firsts[i / BLOCK], i);
        if k < params.capacity {
            color = vec3<f32>(rgb[3u * k], rgb[3u * k + 1u], rgb[3u * k + 2u]);
        }
    }
    image[3u * i] = color.x;
    image[3u * i + 1u] = color.y;
    image[3u * i + 2u] = color.z;
}
