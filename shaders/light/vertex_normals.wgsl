// vertex_normals = Σ face_normals over the corners at a vertex, made unit; one invocation a vertex.
#import shared/linear_index
#import shared/unit_or_zero

struct Params {
    n_vertices: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> corner_starts: array<u32>; // [V + 1]
@group(0) @binding(2) var<storage, read> corners: array<u32>; // 3 · face + corner
@group(0) @binding(3) var<storage, read> face_normals: array<f32>; // [F, 3]
@group(0) @binding(4) var<storage, read_write> vertex_normals: array<f32>; // [V, 3]

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let v = linear_index(id, groups, 64u);
    if v >= params.n_vertices {
        return;
    }
    var sum = vec3(0.0);
    for (var at = corner_starts[v]; at < corner_starts[v + 1u]; at++) {
        let face = 3u * (corners[at] / 3u);
        sum += vec3(face_normals[face], face_normals[face + 1u], face_normals[face + 2u]);
    }
    sum = unit_or_zero(sum);
    vertex_normals[3u * v] = sum.x;
    vertex_normals[3u * v + 1u] = sum.y;
    vertex_normals[3u * v + 2u] = sum.z;
}
