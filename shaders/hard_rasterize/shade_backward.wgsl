// One face that owns a pixel an invocation: grad_face_colours += sum of grad_image over the pixels that the face owns.
#import shared/linear_index
#import shared/hard_triangle
#import shared/owned_pixels

@group(0) @binding(0) var<uniform> params: HardParams;
@group(0) @binding(1) var<storage, read> view: array<f32>;
@group(0) @binding(2) var<storage, read> faces: array<u32>;
@group(0) @binding(3) var<storage, read> pix_to_face: array<i32>;
@group(0) @binding(4) var<storage, read> grad_image: array<f32>;
@group(0) @binding(5) var<storage, read_write> grad_face_colours: array<f32>;
@group(0) @binding(6) var<storage, read> counts: array<u32>; // of pixels, of faces
@group(0) @binding(7) var<storage, read> owners: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let k = linear_index(id, groups, 64u);
    if k >= counts[1] {
        return;
    }
    let f = owners[k];
    let box = pixel_box(triangle_at(f));
    var sum = vec3<f32>(0.0);
    var cursor = vec2<i32>(box.x0, box.y0);
    loop {
        let at = next_owned(f, box, &cursor);
        if at.x < 0 {
            break;
        }
        let pixel = u32(at.y) * params.width + u32(at.x);
        sum += vec3<f32>(grad_image[3u * pixel], grad_image[3u * pixel + 1u], grad_image[3u * pixel + 2u]);
    }
    grad_face_colours[3u * f] += sum.x;
    grad_face_colours[3u * f + 1u] += sum.y;
    grad_face_colours[3u * f + 2u] += sum.z;
}
