// Adds to grad_coords what grad_encoded says. A coordinate outside [0, 1] was clamped: it gets no gradient.
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
@group(0) @binding(4) var<storage, read> grad_encoded: array<vec2<f32>>;
@group(0) @binding(5) var<storage, read_write> grad_coords: array<f32>;

@compute @workgroup_size(LANES)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let p = linear_index(id, groups, LANES);
    if p >= min(params.n_max, count[0]) {
        return;
    }
    let x = vec3<f32>(coords[3u * p], coords[3u * p + 1u], coords[3u * p + 2u]);
    var grad = vec3<f32>(0.0);
    for (var l = 0u; l < params.n_levels; l++) {
        let upstream = grad_encoded[p * ENCODED4 * 2u + l];
        if all(upstream == vec2<f32>(0.0)) {
            continue;
        }
        let level = params.levels[l];
        let cell = cell_of(x, level);
        let entries = corner_entries(cell.corner, level);
        let f = cell.place;
        let g = 1.0 - f;
#for K in 0..8
        let v$K = dot(table[entries[$K]], upstream);
#end
        // Differences along each axis, interpolated along the two others.
        let x0 = (v1 - v0) * g.y + (v3 - v2) * f.y;
        let x1 = (v5 - v4) * g.y + (v7 - v6) * f.y;
        let y0 = (v2 - v0) * g.x + (v3 - v1) * f.x;
        let y1 = (v6 - v4) * g.x + (v7 - v5) * f.x;
        let z0 = (v4 - v0) * g.x + (v5 - v1) * f.x;
        let z1 = (v6 - v2) * g.x + (v7 - v3) * f.x;
        let slope = vec3<f32>(x0 * g.z + x1 * f.z, y0 * g.z + y1 * f.z, z0 * g.y + z1 * f.y);
        grad += slope * level.scale;
    }
    grad = select(vec3<f32>(0.0), grad, x >= vec3<f32>(0.0) & x <= vec3<f32>(1.0));
    grad_coords[3u * p] += grad.x;
    grad_coords[3u * p + 1u] += grad.y;
    grad_coords[3u * p + 2u] += grad.z;
}
