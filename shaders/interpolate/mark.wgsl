// masks[block]: which of the block's 32 pixels have a face and are in the sample.
#import shared/linear_index
#import shared/listed
#import shared/sample

struct Params {
    n_pixels: u32,
    seed: u32,
    threshold: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> pix_to_face: array<i32>;
@group(0) @binding(2) var<storage, read_write> masks: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let block = linear_index(id, groups, 64u);
    let first = block * BLOCK;
    if first >= params.n_pixels {
        return;
    }
    let end = min(first + BLOCK, params.n_pixels);
    var mask = 0u;
    for (var i = first; i < end; i++) {
        if pix_to_face[i] >= 0 && is_sampled(i, params.seed, params.threshold) {
            mask |= 1u << (i - first);
        }
    }
    masks[block] = mask;
}
