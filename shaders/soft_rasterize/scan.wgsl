// Pass 2, one workgroup: where each tile's list starts, which tiles have one, where each class of drawn faces starts, and how many
// workgroups tiles and faces take, one each and at WORKGROUP each. Leaves `counts` zero for the next image.
#import shared/linear_groups
#import shared/soft_face

#const LANES: u32 = 256u
// Lanes whose sums are summed up first.
const BLOCK: u32 = 32u;

@group(0) @binding(0) var<uniform> params: SoftParams;
@group(0) @binding(1) var<storage, read_write> counts: array<u32>;
@group(0) @binding(2) var<storage, read_write> starts: array<u32>; // [n_tiles + 1]
@group(0) @binding(3) var<storage, read_write> cursors: array<u32>; // [n_tiles], then of the drawn faces
@group(0) @binding(4) var<storage, read_write> busy: array<u32>; // how many tiles, then which
@group(0) @binding(5) var<storage, read_write> drawn: array<u32>;
@group(0) @binding(6) var<storage, read_write> workgroups: array<u32>; // of the busy tiles, of the drawn faces; the same at WORKGROUP each

var<workgroup> sums: array<u32, LANES>;
var<workgroup> of_blocks: array<u32, LANES / BLOCK>;
// How many tiles each class has, then where its next one goes; and how many drawn faces, then where its first one goes.
var<workgroup> classes: array<atomic<u32>, SIZES>;
var<workgroup> face_classes: array<u32, SIZES>;

fn write_workgroups(at: u32, n: u32) {
    let spread = linear_groups(n);
    workgroups[at] = spread[0];
    workgroups[at + 1u] = spread[1];
    workgroups[at + 2u] = spread[2];
}

// Of WORKGROUP items each, see `dealt_item`.
fn dealt_groups(n: u32) -> u32 {
    return (n + WORKGROUP * DEALT - 1u) / (WORKGROUP * DEALT) * DEALT;
}

@compute @workgroup_size(LANES)
fn main(@builtin(local_invocation_index) lane: u32) {
    let chunk = (params.n_tiles + LANES - 1u) / LANES;
    let first = min(lane * chunk, params.n_tiles);
    let end = min(first + chunk, params.n_tiles);
    for (var i = lane; i < SIZES; i += LANES) {
        atomicStore(&classes[i], 0u);
        face_classes[i] = counts[params.n_tiles + i];
        counts[params.n_tiles + i] = 0u;
    }
    workgroupBarrier();
    var sum = 0u;
    for (var i = first; i < end; i++) {
        let count = counts[i];
        sum += count;
        if count > 0u {
            atomicAdd(&classes[size_class(count)], 1u);
        }
    }
    sums[lane] = sum;
    workgroupBarrier();
    if lane < LANES / BLOCK {
        var of_block = 0u;
        for (var i = 0u; i < BLOCK; i++) {
            of_block += sums[lane * BLOCK + i];
        }
        of_blocks[lane] = of_block;
    }
    if lane == LANES - 1u {
        var n_busy = 0u;
        var n_drawn = 0u;
        for (var i = 0u; i < SIZES; i++) {
            n_busy += atomicExchange(&classes[i], n_busy);
            let faces = face_classes[i];
            face_classes[i] = n_drawn;
            n_drawn += faces;
        }
        busy[0] = n_busy;
        drawn[0] = n_drawn;
        write_workgroups(0u, n_busy);
        write_workgroups(3u, n_drawn);
        write_workgroups(6u, dealt_groups(n_busy));
        write_workgroups(9u, dealt_groups(n_drawn));
    }
    workgroupBarrier();
    for (var i = lane; i < SIZES; i += LANES) {
        cursors[params.n_tiles + i] = face_classes[i];
    }
    var at = 0u;
    for (var block = 0u; block < lane / BLOCK; block++) {
        at += of_blocks[block];
    }
    for (var i = lane / BLOCK * BLOCK; i < lane; i++) {
        at += sums[i];
    }
    for (var i = first; i < end; i++) {
        let count = counts[i];
        starts[i] = at;
        cursors[i] = at;
        if count > 0u {
            busy[1u + atomicAdd(&classes[size_class(count)], 1u)] = i;
        }
        at += count;
        counts[i] = 0u;
    }
    if lane == LANES - 1u {
        starts[params.n_tiles] = at;
    }
}
