// The list, in the order of the pixels.
#import shared/linear_index
#import shared/listed

struct Params {
    n_pixels: u32,
    capacity: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> masks: array<u32>;
@group(0) @binding(2) var<storage, read> firsts: array<u32>;
@group(0) @binding(3) var<storage, read_write> pixel_index: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = linear_index(id, groups, 64u);
    if i >= params.n_pixels {
        return;
    }
    let mask = masks[i / BLOCK];
    let k = place_of(mask, firsts[i / BLOCK], i);
    if is_listed(mask, i) && k < params.capacity {
        pixel_index[k] = i;
    }
}
