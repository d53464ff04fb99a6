// One face that owns a pixel an invocation: the gradient of its corners [F, 3, 3] from the motion, in the image, of the points that its
// pixels show. The point P = sum bary_k v_k moves with fixed bary, and u = fx X/Z + cx, v = fy Y/Z + cy.
#import shared/linear_index
#import shared/hard_triangle
#import shared/owned_pixels

@group(0) @binding(0) var<uniform> params: HardParams;
@group(0) @binding(1) var<storage, read> view: array<f32>;
@group(0) @binding(2) var<storage, read> faces: array<u32>;
@group(0) @binding(3) var<storage, read> pix_to_face: array<i32>;
@group(0) @binding(4) var<storage, read> grad_screen: array<vec2<f32>>;
@group(0) @binding(5) var<storage, read_write> grad_corners: array<f32>;
@group(0) @binding(6) var<storage, read> counts: array<u32>; // of pixels, of faces
@group(0) @binding(7) var<storage, read> owners: array<u32>;

fn write_corner(i: u32, g: vec3<f32>) {
    grad_corners[i] = g.x;
    grad_corners[i + 1u] = g.y;
    grad_corners[i + 2u] = g.z;
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let k = linear_index(id, groups, 64u);
    if k >= counts[1] {
        return;
    }
    let f = owners[k];
    let t = triangle_at(f);
    let box = pixel_box(t);
    var ga = vec3<f32>(0.0);
    var gb = vec3<f32>(0.0);
    var gc = vec3<f32>(0.0);
    var cursor = vec2<i32>(box.x0, box.y0);
    loop {
        let at = next_owned(f, box, &cursor);
        if at.x < 0 {
            break;
        }
        let pixel = u32(at.y) * params.width + u32(at.x);
        let ray = ray_at(at.x, at.y);
        let m = meet(t, ray);
        let bary = m.d / m.total;
        // P = ray z, so X/Z is the ray's.
        let g = grad_screen[pixel] * vec2<f32>(params.fx, params.fy) / depth_of(t, m);
        let gp = vec3<f32>(g, -dot(g, ray));
        ga += bary.x * gp;
        gb += bary.y * gp;
        gc += bary.z * gp;
    }
    write_corner(9u * f, ga);
    write_corner(9u * f + 3u, gb);
    write_corner(9u * f + 6u, gc);
}
