// Pass 3 where the faces are all that is wanted, one pixel an invocation. Leaves `nearest` and `owner` zero for the next image.
#import shared/linear_index

struct Params {
    n_faces: u32,
    n_pixels: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> nearest: array<u32>;
@group(0) @binding(2) var<storage, read_write> owner: array<u32>;
@group(0) @binding(3) var<storage, read_write> pix_to_face: array<i32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let pixel = linear_index(id, groups, 64u);
    if pixel >= params.n_pixels {
        return;
    }
    let owned = owner[pixel];
    owner[pixel] = 0u;
    nearest[pixel] = 0u;
    pix_to_face[pixel] = select(-1, i32(params.n_faces - owned), owned > 0u);
}
