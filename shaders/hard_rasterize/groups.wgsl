// How many workgroups of 64 a list takes.
#import shared/linear_groups

struct Params {
    list: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> counts: array<u32>; // of pixels, of faces
@group(0) @binding(2) var<storage, read_write> groups: array<u32>;

@compute @workgroup_size(1)
fn main() {
    let spread = linear_groups((counts[params.list] + 63u) / 64u);
    groups[3u * params.list] = spread[0];
    groups[3u * params.list + 1u] = spread[1];
    groups[3u * params.list + 2u] = spread[2];
}
