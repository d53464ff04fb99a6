// parts[k] = the parts of the shade of Σ_c bary_coords[pixel, c] · vertex normal of corner c, times what reaches the pixel of the
// ambient light and of the lamp, the same sum of the corners' exposure, for pixel = pixel_index[k].
#import shared/linear_index
#import shared/shade_parts

struct Params {
    direction: vec3<f32>,
    wrap: f32,
    slope: vec3<f32>,
    n_max: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> count: array<u32>;
@group(0) @binding(2) var<storage, read> pixel_index: array<u32>;
@group(0) @binding(3) var<storage, read> pix_to_face: array<i32>; // [H, W]
@group(0) @binding(4) var<storage, read> bary_coords: array<f32>; // [H, W, 3]
@group(0) @binding(5) var<storage, read> faces: array<u32>; // [F, 3]
@group(0) @binding(6) var<storage, read> vertex_normals: array<f32>; // [V, 3], unit
@group(0) @binding(7) var<storage, read> exposure: array<vec2<f32>>; // [V]
@group(0) @binding(8) var<storage, read_write> parts: array<vec2<f32>>; // [P]

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let k = linear_index(id, groups, 64u);
    if k >= min(params.n_max, count[0]) {
        return;
    }
    let pixel = pixel_index[k];
    let face = 3u * u32(pix_to_face[pixel]);
    var normal = vec3(0.0);
    var reaching = vec2(0.0);
    for (var c = 0u; c < 3u; c++) {
        let corner = faces[face + c];
        let v = 3u * corner;
        let bary = bary_coords[3u * pixel + c];
        normal += bary * vec3(vertex_normals[v], vertex_normals[v + 1u], vertex_normals[v + 2u]);
        reaching += bary * exposure[corner];
    }
    parts[k] = reaching * shade_parts(Light(params.direction, params.wrap, params.slope), normal);
}
