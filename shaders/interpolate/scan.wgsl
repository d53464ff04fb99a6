// firsts[block] = listed pixels before the block; count = all of them, at most the list's capacity. One workgroup: an
// invocation sums a run of blocks, then starts its run after all runs before.
#import shared/linear_groups

#const LANES: u32 = 256u

struct Params {
    n_blocks: u32,
    capacity: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> masks: array<u32>;
@group(0) @binding(2) var<storage, read_write> firsts: array<u32>;
@group(0) @binding(3) var<storage, read_write> count: array<u32>;
@group(0) @binding(4) var<storage, read_write> workgroups: array<u32>; // of 64, for the listed pixels

var<workgroup> sums: array<u32, LANES>;

@compute @workgroup_size(LANES)
fn main(@builtin(local_invocation_index) lane: u32) {
    let run = (params.n_blocks + LANES - 1u) / LANES;
    let begin = min(lane * run, params.n_blocks);
    let end = min(begin + run, params.n_blocks);
    var sum = 0u;
    for (var block = begin; block < end; block++) {
        sum += countOneBits(masks[block]);
    }
    sums[lane] = sum;
    workgroupBarrier();
    var first = 0u;
    for (var k = 0u; k < lane; k++) {
        first += sums[k];
    }
    if lane == LANES - 1u {
        let listed = min(first + sum, params.capacity);
        count[0] = listed;
        let spread = linear_groups((listed + 63u) / 64u);
        workgroups[0] = spread[0];
        workgroups[1] = spread[1];
        workgroups[2] = spread[2];
    }
    for (var block = begin; block < end; block++) {
        firsts[block] = first;
        first += countOneBits(masks[block]);
    }
}
