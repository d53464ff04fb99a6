// How many workgroups the listed pixels take in each kind of kernel. A list is mostly much shorter than its capacity, and
// a workgroup that finds nothing to do costs as much as another where the driver never jumps.
#const LANES: u32 = 256u
#const CHUNK: u32 = 256u
#const RUN: u32 = 32u

struct Params {
    n_max: u32,
    n_levels: u32,
    // Along x, of the three layers' weights.
    tiles0: u32,
    tiles1: u32,
    tiles2: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> count: array<u32>;
// A pixel an invocation; a run of pixels in a level; a chunk of a layer's weights, three times.
@group(0) @binding(2) var<storage, read_write> groups: array<u32>;

fn write(at: u32, x: u32, y: u32) {
    groups[at] = x;
    groups[at + 1u] = y;
    groups[at + 2u] = 1u;
}

@compute @workgroup_size(1)
fn main() {
    let n = min(params.n_max, count[0]);
    let chunks = (n + CHUNK - 1u) / CHUNK;
    write(0u, (n + LANES - 1u) / LANES, 1u);
    // Levels side by side: fine ones take longest, and a software driver gives each of its threads one stretch of the workgroups.
    write(3u, params.n_levels, (n + 64u * RUN - 1u) / (64u * RUN));
    write(6u, params.tiles0, chunks);
    write(9u, params.tiles1, chunks);
    write(12u, params.tiles2, chunks);
}
