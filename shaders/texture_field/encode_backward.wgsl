// Adds to grad_table (atomically) and to grad_coords what grad_encoded says. A coordinate outside [0, 1] was clamped:
// it gets no gradient.
#import shared/linear_index
#import shared/hash_grid
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
@group(0) @binding(5) var<storage, read_write> grad_table: array<atomic_f32>;
@group(0) @binding(6) var<storage, read_write> grad_coords: array<f32>;

#atomic_f32 grad_table

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let p = linear_index(id, groups, 64u);
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
        var slope = vec3<f32>(0.0);
#for K in 0..8
        {
            let along = vec3<f32>(select(g.x, f.x, ($Ku & 1u) != 0u), select(g.y, f.y, ($Ku & 2u) != 0u), select(g.z, f.z, ($Ku & 4u) != 0u));
            let weight = along.x * along.y * along.z;
            let entry = entries[$K];
            grad_table_add(2u * entry, weight * upstream.x);
            grad_table_add(2u * entry + 1u, weight * upstream.y);
            let value = dot(table[entry], upstream);
            slope.x += select(-value, value, ($Ku & 1u) != 0u) * along.y * along.z;
            slope.y += select(-value, value, ($Ku & 2u) != 0u) * along.x * along.z;
            slope.z += select(-value, value, ($Ku & 4u) != 0u) * along.x * along.y;
        }
#end
        grad += slope * level.scale;
    }
    grad = select(vec3<f32>(0.0), grad, x >= vec3<f32>(0.0) & x <= vec3<f32>(1.0));
    grad_coords[3u * p] += grad.x;
    grad_coords[3u * p + 1u] += grad.y;
    grad_coords[3u * p + 2u] += grad.z;
}
