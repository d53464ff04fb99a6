// grad_normals += λ (I − n̂n̂ᵀ) (−Σ_g n̂_g) / |n|; one invocation a face.
#import shared/linear_index
#import shared/unit_or_zero

struct Params {
    n_faces: u32,
    weight: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> starts: array<u32>; // [F + 1]
@group(0) @binding(2) var<storage, read> neighbours: array<u32>;
@group(0) @binding(3) var<storage, read> normals: array<f32>; // [F, 3]
@group(0) @binding(4) var<storage, read_write> grad_normals: array<f32>; // [F, 3]

fn normal_at(f: u32) -> vec3<f32> {
    return vec3<f32>(normals[3u * f], normals[3u * f + 1u], normals[3u * f + 2u]);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let f = linear_index(id, groups, 64u);
    if f >= params.n_faces {
        return;
    }
    let unit = unit_or_zero(normal_at(f));
    // n · n̂ is |n|, and zero for a face without area, which has no gradient.
    let norm = dot(normal_at(f), unit);
    if norm == 0.0 {
        return;
    }
    var sum = vec3<f32>();
    for (var at = starts[f]; at < starts[f + 1u]; at++) {
        sum += unit_or_zero(normal_at(neighbours[at]));
    }
    let grad = (params.weight / norm) * (dot(sum, unit) * unit - sum);
    grad_normals[3u * f] += grad.x;
    grad_normals[3u * f + 1u] += grad.y;
    grad_normals[3u * f + 2u] += grad.z;
}
