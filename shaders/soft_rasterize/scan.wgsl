// Pass 2, one workgroup: where each tile's list starts. Leaves `counts` zero for the next image.
#import shared/soft_face

const LANES: u32 = 256u;

@group(0) @binding(0) var<uniform> params: SoftParams;
@group(0) @binding(1) var<storage, read_write> counts: array<u32>;
@group(0) @binding(2) var<storage, read_write> starts: array<u32>; // [n_tiles + 1]
@group(0) @binding(3) var<storage, read_write> cursors: array<u32>;

var<workgroup> sums: array<u32, 256>;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) lane: u32) {
    let chunk = (params.n_tiles + LANES - 1u) / LANES;
    let first = min(lane * chunk, params.n_tiles);
    let end = min(first + chunk, params.n_tiles);
    var sum = 0u;
    for (var i = first; i < end; i++) {
        sum += counts[i];
    }
    sums[lane] = sum;
    workgroupBarrier();
    var at = 0u;
    for (var i = 0u; i < lane; i++) {
        at += sums[i];
    }
    for (var i = first; i < end; i++) {
        starts[i] = at;
        cursors[i] = at;
        at += counts[i];
        counts[i] = 0u;
    }
    if lane == LANES - 1u {
        starts[params.n_tiles] = at;
    }
}
