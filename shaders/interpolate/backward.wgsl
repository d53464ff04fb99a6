// sums[v] += bary · grad_coords[k] for the corners of each listed pixel's face.
#import shared/linear_index
#import shared/exact_sum

struct Params {
    n_max: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> count: array<u32>;
@group(0) @binding(2) var<storage, read> pixel_index: array<u32>;
@group(0) @binding(3) var<storage, read> pix_to_face: array<i32>;
@group(0) @binding(4) var<storage, read> bary_coords: array<f32>;
@group(0) @binding(5) var<storage, read> faces: array<u32>;
@group(0) @binding(6) var<storage, read> grad_coords: array<f32>;
@group(0) @binding(7) var<storage, read_write> sums: array<exact_sum>; // [V, 3, 2]

#exact_sum sums

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let k = linear_index(id, groups, 64u);
    if k >= min(params.n_max, count[0]) {
        return;
    }
    let grad = vec3<f32>(grad_coords[3u * k], grad_coords[3u * k + 1u], grad_coords[3u * k + 2u]);
    if all(grad == vec3<f32>(0.0)) {
        return;
    }
    let i = pixel_index[k];
    let face = 3u * u32(pix_to_face[i]);
    for (var c = 0u; c < 3u; c++) {
        let v = 3u * faces[face + c];
        let b = bary_coords[3u * i + c];
        sums_add(v, b * grad.x);
        sums_add(v + 1u, b * grad.y);
        sums_add(v + 2u, b * grad.z);
    }
}
