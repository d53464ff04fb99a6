// Pass 2, one workgroup: where each tile's list starts, which tiles have one, and how many workgroups they and the drawn
// faces take, one each, and the tiles at 64 each. Leaves `counts` zero for the next image.
#import shared/soft_face

#const LANES: u32 = 256u
// Lanes whose sums are summed up first.
const BLOCK: u32 = 32u;
// Workgroups along x at most; see `linear_groups` of the host.
const ROW: u32 = 32768u;

@group(0) @binding(0) var<uniform> params: SoftParams;
@group(0) @binding(1) var<storage, read_write> counts: array<u32>;
@group(0) @binding(2) var<storage, read_write> starts: array<u32>; // [n_tiles + 1]
@group(0) @binding(3) var<storage, read_write> cursors: array<u32>;
@group(0) @binding(4) var<storage, read_write> busy: array<u32>; // how many tiles, then which
@group(0) @binding(5) var<storage, read_write> drawn: array<u32>;
@group(0) @binding(6) var<storage, read_write> workgroups: array<u32>; // of the busy tiles, of the drawn faces, of 64 tiles each

var<workgroup> sums: array<vec2<u32>, LANES>;
var<workgroup> of_blocks: array<vec2<u32>, LANES / BLOCK>;

fn write_workgroups(at: u32, n: u32) {
    workgroups[at] = min(n, ROW);
    workgroups[at + 1u] = (n + ROW - 1u) / ROW;
    workgroups[at + 2u] = 1u;
}

@compute @workgroup_size(LANES)
fn main(@builtin(local_invocation_index) lane: u32) {
    let chunk = (params.n_tiles + LANES - 1u) / LANES;
    let first = min(lane * chunk, params.n_tiles);
    let end = min(first + chunk, params.n_tiles);
    // Entries and tiles.
    var sum = vec2<u32>(0u);
    for (var i = first; i < end; i++) {
        let count = counts[i];
        sum += vec2<u32>(count, min(count, 1u));
    }
    sums[lane] = sum;
    workgroupBarrier();
    if lane < LANES / BLOCK {
        var of_block = vec2<u32>(0u);
        for (var i = 0u; i < BLOCK; i++) {
            of_block += sums[lane * BLOCK + i];
        }
        of_blocks[lane] = of_block;
    }
    workgroupBarrier();
    var at = vec2<u32>(0u);
    for (var block = 0u; block < lane / BLOCK; block++) {
        at += of_blocks[block];
    }
    for (var i = lane / BLOCK * BLOCK; i < lane; i++) {
        at += sums[i];
    }
    for (var i = first; i < end; i++) {
        let count = counts[i];
        starts[i] = at.x;
        cursors[i] = at.x;
        if count > 0u {
            busy[1u + at.y] = i;
        }
        at += vec2<u32>(count, min(count, 1u));
        counts[i] = 0u;
    }
    if lane == LANES - 1u {
        starts[params.n_tiles] = at.x;
        busy[0] = at.y;
        write_workgroups(0u, at.y);
        write_workgroups(6u, (at.y + 63u) / 64u);
        let n_drawn = counts[params.n_tiles];
        counts[params.n_tiles] = 0u;
        drawn[0] = n_drawn;
        write_workgroups(3u, n_drawn);
    }
}
