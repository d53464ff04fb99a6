// grad_normals += λ (1 − 1/r²) n̂ / |n'| with r = A/A' = |n|/|n'|; one invocation a face.
#import shared/linear_index
#import shared/area_ratio
#import shared/unit_or_zero

struct Params {
    n_faces: u32,
    ratio_min: f32,
    least_rest: f32,
    weight: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> normals: array<f32>; // [F, 3]
@group(0) @binding(2) var<storage, read> rest_normals: array<f32>; // [F, 3]
@group(0) @binding(3) var<storage, read_write> grad_normals: array<f32>; // [F, 3]

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let f = linear_index(id, groups, 64u);
    if f >= params.n_faces {
        return;
    }
    let n = vec3<f32>(normals[3u * f], normals[3u * f + 1u], normals[3u * f + 2u]);
    let rest = length(vec3<f32>(rest_normals[3u * f], rest_normals[3u * f + 1u], rest_normals[3u * f + 2u]));
    if rest <= params.least_rest {
        return;
    }
    let grad = (params.weight * ratio_slope(length(n) / rest, params.ratio_min) / rest) * unit_or_zero(n);
    grad_normals[3u * f] += grad.x;
    grad_normals[3u * f + 1u] += grad.y;
    grad_normals[3u * f + 2u] += grad.z;
}
