// The list, in the order of the pixels: pixel_index[k] and coords[k] = Σ bary_coords · texcoords of the face's corners.
#import shared/linear_index
#import shared/listed

struct Params {
    n_pixels: u32,
    capacity: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> masks: array<u32>;
@group(0) @binding(2) var<storage, read> firsts: array<u32>;
@group(0) @binding(3) var<storage, read> pix_to_face: array<i32>;
@group(0) @binding(4) var<storage, read> bary_coords: array<f32>;
@group(0) @binding(5) var<storage, read> faces: array<u32>;
@group(0) @binding(6) var<storage, read> texcoords: array<f32>;
@group(0) @binding(7) var<storage, read_write> pixel_index: array<u32>;
@group(0) @binding(8) var<storage, read_write> coords: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = linear_index(id, groups, 64u);
    if i >= params.n_pixels {
        return;
    }
    let mask = masks[i / BLOCK];
    if !is_listed(mask, i) {
        return;
    }
    let k = place_of(mask, firsts[i / BLOCK], i);
    if k >= params.capacity {
        return;
    }
    let face = 3u * u32(pix_to_face[i]);
    var x = vec3<f32>(0.0);
    for (var c = 0u; c < 3u; c++) {
        let v = 3u * faces[face + c];
        x += bary_coords[3u * i + c] * vec3<f32>(texcoords[v], texcoords[v + 1u], texcoords[v + 2u]);
    }
    pixel_index[k] = i;
    coords[3u * k] = x.x;
    coords[3u * k + 1u] = x.y;
    coords[3u * k + 2u] = x.z;
}
