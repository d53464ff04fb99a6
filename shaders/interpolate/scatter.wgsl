// image[pixel_index[k]] = rgb[k].
#import shared/linear_index

struct Params {
    n_max: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> count: array<u32>;
@group(0) @binding(2) var<storage, read> pixel_index: array<u32>;
@group(0) @binding(3) var<storage, read> rgb: array<f32>;
@group(0) @binding(4) var<storage, read_write> image: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let k = linear_index(id, groups, 64u);
    if k >= min(params.n_max, count[0]) {
        return;
    }
    let i = pixel_index[k];
    image[3u * i] = rgb[3u * k];
    image[3u * i + 1u] = rgb[3u * k + 1u];
    image[3u * i + 2u] = rgb[3u * k + 2u];
}
