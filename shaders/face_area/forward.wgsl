// values = A/A' + A'/A; one invocation a face.
#import shared/linear_index
#import shared/area_ratio

struct Params {
    n_faces: u32,
    ratio_min: f32,
    least_rest: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> normals: array<f32>; // [F, 3]
@group(0) @binding(2) var<storage, read> rest_normals: array<f32>; // [F, 3]
@group(0) @binding(3) var<storage, read_write> values: array<f32>; // [F]

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let f = linear_index(id, groups, 64u);
    if f >= params.n_faces {
        return;
    }
    let norm = length(vec3<f32>(normals[3u * f], normals[3u * f + 1u], normals[3u * f + 2u]));
    let rest = length(vec3<f32>(rest_normals[3u * f], rest_normals[3u * f + 1u], rest_normals[3u * f + 2u]));
    if rest <= params.least_rest {
        values[f] = 0.0;
        return;
    }
    values[f] = ratio_cost(norm / rest, params.ratio_min);
}
