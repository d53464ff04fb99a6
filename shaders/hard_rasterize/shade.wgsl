// One owned pixel an invocation: the colour of its face.
#import shared/linear_index

struct Params {
    n_pixels: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> counts: array<u32>; // of pixels, of faces
@group(0) @binding(2) var<storage, read> owned: array<u32>;
@group(0) @binding(3) var<storage, read> pix_to_face: array<i32>;
@group(0) @binding(4) var<storage, read> face_colours: array<f32>;
@group(0) @binding(5) var<storage, read_write> image: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let k = linear_index(id, groups, 64u);
    if k >= min(counts[0], params.n_pixels) {
        return;
    }
    let pixel = owned[k];
    let i = 3u * u32(pix_to_face[pixel]);
    image[3u * pixel] = face_colours[i];
    image[3u * pixel + 1u] = face_colours[i + 1u];
    image[3u * pixel + 2u] = face_colours[i + 2u];
}
