// One pixel an invocation: the colour of its face, or the background.
#import shared/linear_index

struct Params {
    n_pixels: u32,
    red: f32,
    green: f32,
    blue: f32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> pix_to_face: array<i32>;
@group(0) @binding(2) var<storage, read> face_colours: array<f32>;
@group(0) @binding(3) var<storage, read_write> image: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let pixel = linear_index(id, groups, 64u);
    if pixel >= params.n_pixels {
        return;
    }
    let f = pix_to_face[pixel];
    var colour = vec3<f32>(params.red, params.green, params.blue);
    if f >= 0 {
        let i = 3u * u32(f);
        colour = vec3<f32>(face_colours[i], face_colours[i + 1u], face_colours[i + 2u]);
    }
    image[3u * pixel] = colour.x;
    image[3u * pixel + 1u] = colour.y;
    image[3u * pixel + 2u] = colour.z;
}
