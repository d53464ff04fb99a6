// How many workgroups of LANES the listed pixels take. A list is mostly much shorter than its capacity, and the
// perceptron's kernels cannot leave early.
#const LANES: u32 = 256u

struct Params {
    n_max: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> count: array<u32>;
@group(0) @binding(2) var<storage, read_write> groups: array<u32>;

@compute @workgroup_size(1)
fn main() {
    groups[0] = (min(params.n_max, count[0]) + LANES - 1u) / LANES;
    groups[1] = 1u;
    groups[2] = 1u;
}
