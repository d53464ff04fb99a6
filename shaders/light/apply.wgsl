// shaded = values · (ambient · part 0 + strength · part 1), added to it, or cut at one; see src/ops/light/mod.rs.
#import shared/linear_index

struct Params {
    ambient: vec3<f32>,
    n_max: u32,
    strength: vec3<f32>,
    write: u32, // 0 over, 1 add, 2 over and cut
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> count: array<u32>;
@group(0) @binding(2) var<storage, read> parts: array<f32>; // [R, 2]
@group(0) @binding(3) var<storage, read> values: array<f32>;
@group(0) @binding(4) var<storage, read_write> shaded: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = linear_index(id, groups, 64u);
    if i >= min(params.n_max, count[0]) {
        return;
    }
    let at = 3u * i;
    let shade = params.ambient * parts[2u * i] + params.strength * parts[2u * i + 1u];
    var result = vec3(values[at], values[at + 1u], values[at + 2u]) * shade;
    if params.write == 1u {
        result += vec3(shaded[at], shaded[at + 1u], shaded[at + 2u]);
    } else if params.write == 2u {
        result = min(result, vec3(1.0));
    }
    shaded[at] = result.x;
    shaded[at + 1u] = result.y;
    shaded[at + 2u] = result.z;
}
