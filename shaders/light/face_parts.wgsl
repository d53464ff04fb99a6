// parts[f] = the parts of the shade of face normal f, times what reaches face f of the ambient light and of the lamp: the mean of
// its corners.
#import shared/linear_index
#import shared/shade_parts

struct Params {
    direction: vec3<f32>,
    wrap: f32,
    slope: vec3<f32>,
    n: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> faces: array<u32>; // [F, 3]
@group(0) @binding(2) var<storage, read> normals: array<f32>; // [F, 3]
@group(0) @binding(3) var<storage, read> exposure: array<vec2<f32>>; // [V]
@group(0) @binding(4) var<storage, read_write> parts: array<vec2<f32>>; // [F]

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = linear_index(id, groups, 64u);
    if i >= params.n {
        return;
    }
    var reaching = vec2(0.0);
    for (var c = 0u; c < 3u; c++) {
        reaching += exposure[faces[3u * i + c]];
    }
    let normal = vec3(normals[3u * i], normals[3u * i + 1u], normals[3u * i + 2u]);
    parts[i] = reaching / 3.0 * shade_parts(Light(params.direction, params.wrap, params.slope), normal);
}
