// coords[k] = Σ bary_coords · texcoords of the corners of the listed pixel's face.
#import shared/linear_index

struct Params {
    n_max: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> count: array<u32>;
@group(0) @binding(2) var<storage, read> pixel_index: array<u32>;
@group(0) @binding(3) var<storage, read> pix_to_face: array<i32>;
@group(0) @binding(4) var<storage, read> bary_coords: array<f32>;
@group(0) @binding(5) var<storage, read> faces: array<u32>;
@group(0) @binding(6) var<storage, read> texcoords: array<f32>;
@group(0) @binding(7) var<storage, read_write> coords: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let k = linear_index(id, groups, 64u);
    if k >= min(params.n_max, count[0]) {
        return;
    }
    let i = pixel_index[k];
    let face = 3u * u32(pix_to_face[i]);
    var x = vec3<f32>(0.0);
    for (var c = 0u; c < 3u; c++) {
        let v = 3u * faces[face + c];
        x += bary_coords[3u * i + c] * vec3<f32>(texcoords[v], texcoords[v + 1u], texcoords[v + 2u]);
    }
    coords[3u * k] = x.x;
    coords[3u * k + 1u] = x.y;
    coords[3u * k + 2u] = x.z;
}
