// Each face's share: values = ½ Σ_g (1 − n̂_f · n̂_g) over the faces across its edges; one invocation a face.
#import shared/linear_index
#import shared/unit_or_zero

struct Params {
    n_faces: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> starts: array<u32>; // [F + 1]
@group(0) @binding(2) var<storage, read> neighbours: array<u32>;
@group(0) @binding(3) var<storage, read> normals: array<f32>; // [F, 3]
@group(0) @binding(4) var<storage, read_write> values: array<f32>; // [F]

fn normal_at(f: u32) -> vec3<f32> {
    return unit_or_zero(vec3<f32>(normals[3u * f], normals[3u * f + 1u], normals[3u * f + 2u]));
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let f = linear_index(id, groups, 64u);
    if f >= params.n_faces {
        return;
    }
    let n = normal_at(f);
    var sum = 0.0;
    for (var at = starts[f]; at < starts[f + 1u]; at++) {
        sum += 1.0 - dot(n, normal_at(neighbours[at]));
    }
    values[f] = 0.5 * sum;
}
