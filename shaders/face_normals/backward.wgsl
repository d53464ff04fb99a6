// grad_vertices += Σ (v_next − v_previous) × grad_normal over the corners at a vertex; one invocation a vertex.
#import shared/linear_index

struct Params {
    n_vertices: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> faces: array<u32>; // [F, 3]
@group(0) @binding(2) var<storage, read> corner_starts: array<u32>; // [V + 1]
@group(0) @binding(3) var<storage, read> corners: array<u32>; // 3 · face + corner
@group(0) @binding(4) var<storage, read> vertices: array<f32>; // [V, 3]
@group(0) @binding(5) var<storage, read> grad_normals: array<f32>; // [F, 3]
@group(0) @binding(6) var<storage, read_write> grad_vertices: array<f32>; // [V, 3]

fn vertex_at(v: u32) -> vec3<f32> {
    return vec3<f32>(vertices[3u * v], vertices[3u * v + 1u], vertices[3u * v + 2u]);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let v = linear_index(id, groups, 64u);
    if v >= params.n_vertices {
        return;
    }
    var grad = vec3<f32>();
    for (var at = corner_starts[v]; at < corner_starts[v + 1u]; at++) {
        let face = 3u * (corners[at] / 3u);
        let k = corners[at] % 3u;
        let opposite = vertex_at(faces[face + (k + 1u) % 3u]) - vertex_at(faces[face + (k + 2u) % 3u]);
        grad += cross(opposite, vec3<f32>(grad_normals[face], grad_normals[face + 1u], grad_normals[face + 2u]));
    }
    grad_vertices[3u * v] += grad.x;
    grad_vertices[3u * v + 1u] += grad.y;
    grad_vertices[3u * v + 2u] += grad.z;
}
