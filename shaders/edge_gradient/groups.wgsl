// How many workgroups of 64 the listed pixels take.
struct Params {
    n_pixels: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> count: array<u32>;
@group(0) @binding(2) var<storage, read_write> groups: array<u32>;

@compute @workgroup_size(1)
fn main() {
    groups[0] = (min(count[0], params.n_pixels) + 63u) / 64u;
    groups[1] = 1u;
    groups[2] = 1u;
}
