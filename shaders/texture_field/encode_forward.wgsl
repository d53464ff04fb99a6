// encoded[p] = trilinear interpolation of the table at coords[p], level by level.
#import shared/linear_index
#import shared/hash_grid
#const LANES: u32 = 256u
#const ENCODED4: u32 = 6u

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
@group(0) @binding(3) var<storage, read> table: array<vec2<f32>>;
@group(0) @binding(4) var<storage, read_write> encoded: array<vec2<f32>>;

@compute @workgroup_size(LANES)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let p = linear_index(id, groups, LANES);
    if p >= min(params.n_max, count[0]) {
        return;
    }
    let x = vec3<f32>(coords[3u * p], coords[3u * p + 1u], coords[3u * p + 2u]);
    for (var l = 0u; l < params.n_levels; l++) {
        let level = params.levels[l];
        let cell = cell_of(x, level);
        let entries = corner_entries(cell.corner, level);
        let f = cell.place;
        let g = 1.0 - f;
        let low = (table[entries[0]] * g.x + table[entries[1]] * f.x) * g.y + (table[entries[2]] * g.x + table[entries[3]] * f.x) * f.y;
        let high = (table[entries[4]] * g.x + table[entries[5]] * f.x) * g.y + (table[entries[6]] * g.x + table[entries[7]] * f.x) * f.y;
        encoded[p * ENCODED4 * 2u + l] = low * g.z + high * f.z;
    }
}
