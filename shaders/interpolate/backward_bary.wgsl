// grad_bary[pixel, c] += grad_coords[k] · texcoords of the face's corner c, for each listed pixel.
#import shared/linear_index

struct Params {
    n_max: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> count: array<u32>;
@group(0) @binding(2) var<storage, read> pixel_index: array<u32>;
@group(0) @binding(3) var<storage, read> pix_to_face: array<i32>;
@group(0) @binding(4) var<storage, read> faces: array<u32>;
@group(0) @binding(5) var<storage, read> texcoords: array<f32>;
@group(0) @binding(6) var<storage, read> grad_coords: array<f32>;
@group(0) @binding(7) var<storage, read_write> grad_bary: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let k = linear_index(id, groups, 64u);
    if k >= min(params.n_max, count[0]) {
        return;
    }
    let grad = vec3<f32>(grad_coords[3u * k], grad_coords[3u * k + 1u], grad_coords[3u * k + 2u]);
    let i = pixel_index[k];
    let face = 3u * u32(pix_to_face[i]);
    for (var c = 0u; c < 3u; c++) {
        let v = 3u * faces[face + c];
        grad_bary[3u * i + c] += dot(grad, vec3<f32>(texcoords[v], texcoords[v + 1u], texcoords[v + 2u]));
    }
}
