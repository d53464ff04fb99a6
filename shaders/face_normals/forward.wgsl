// normals = (v1 − v0) × (v2 − v0); one invocation a face.
#import shared/linear_index

struct Params {
    n_faces: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> faces: array<u32>; // [F, 3]
@group(0) @binding(2) var<storage, read> vertices: array<f32>; // [V, 3]
@group(0) @binding(3) var<storage, read_write> normals: array<f32>; // [F, 3]

fn vertex_at(v: u32) -> vec3<f32> {
    return vec3<f32>(vertices[3u * v], vertices[3u * v + 1u], vertices[3u * v + 2u]);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let f = linear_index(id, groups, 64u);
    if f >= params.n_faces {
        return;
    }
    let origin = vertex_at(faces[3u * f]);
    let n = cross(vertex_at(faces[3u * f + 1u]) - origin, vertex_at(faces[3u * f + 2u]) - origin);
    normals[3u * f] = n.x;
    normals[3u * f + 1u] = n.y;
    normals[3u * f + 2u] = n.z;
}
