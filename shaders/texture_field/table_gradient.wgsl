// Adds to the sums of grad_table what grad_encoded says. An invocation follows a run of listed pixels in one level.
// Neighbours mostly share a cell, so it sums as long as the cell stays the same and adds to the table's sums when it changes.
#import shared/hash_grid
#import shared/exact_sum
#const ENCODED4: u32 = 6u
#const RUN: u32 = 32u

struct Params {
    n_max: u32,
    n_levels: u32,
    pad0: u32,
    pad1: u32,
    levels: array<Level, MAX_LEVELS>,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> count: array<u32>;
@group(0) @binding(2) var<storage, read> coords: array<f32>;
@group(0) @binding(3) var<storage, read> grad_encoded: array<vec2<f32>>;
@group(0) @binding(4) var<storage, read_write> sums: array<exact_sum>; // [entries, 2, 2]

#exact_sum sums

fn add(corner: vec3<u32>, level: Level, parts: array<vec2<f32>, 8>) {
    let entries = corner_entries(corner, level);
#for K in 0..8
    sums_add(2u * entries[$K], parts[$K].x);
    sums_add(2u * entries[$K] + 1u, parts[$K].y);
#end
}

@compute @workgroup_size(64)
fn main(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3<u32>) {
    let at_level = group.x;
    let first = (group.y * 64u + lane) * RUN;
    let end = min(first + RUN, min(params.n_max, count[0]));
    let level = params.levels[at_level];
    var p = first;
    loop {
        if p >= end {
            break;
        }
        // One cell after the other, so that the additions stand outside of the loop over its pixels.
        let x = vec3<f32>(coords[3u * p], coords[3u * p + 1u], coords[3u * p + 2u]);
        let corner = cell_of(x, level).corner;
        var cell = cell_of(x, level);
        var parts = array<vec2<f32>, 8>();
        var same = true;
        while same {
            let upstream = grad_encoded[p * ENCODED4 * 2u + at_level];
            let f = cell.place;
            let g = 1.0 - f;
            let low = vec4<f32>(g.x * g.y, f.x * g.y, g.x * f.y, f.x * f.y) * g.z;
            let high = vec4<f32>(g.x * g.y, f.x * g.y, g.x * f.y, f.x * f.y) * f.z;
#for K in 0..4
            parts[$K] += low[$K] * upstream;
            parts[$K + 4] += high[$K] * upstream;
#end
            p++;
            same = p < end;
            if same {
                cell = cell_of(vec3<f32>(coords[3u * p], coords[3u * p + 1u], coords[3u * p + 2u]), level);
                same = all(cell.corner == corner);
            }
        }
        add(corner, level, parts);
    }
}
