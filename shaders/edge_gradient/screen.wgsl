// One listed pixel an invocation: grad_screen [H, W, 2], how the loss changes when the surface that the pixel shows moves in
// the image, its borders to the four neighbours with it.
#import shared/linear_index
#import shared/silhouette

@group(0) @binding(0) var<uniform> params: SilhouetteParams;
@group(0) @binding(1) var<storage, read> pix_to_face: array<i32>;
@group(0) @binding(2) var<storage, read> zbuf: array<f32>;
@group(0) @binding(3) var<storage, read> alpha: array<f32>;
@group(0) @binding(4) var<storage, read> grad_alpha: array<f32>;
@group(0) @binding(5) var<storage, read> image: array<f32>;
@group(0) @binding(6) var<storage, read> grad_image: array<f32>;
@group(0) @binding(7) var<storage, read_write> grad_screen: array<vec2<f32>>;
@group(0) @binding(8) var<storage, read> count: array<u32>;
@group(0) @binding(9) var<storage, read> borders: array<u32>;

// The gain of a unit step of p's border onto q: the mean gradient there times the change from I_q to I_p.
fn gain(p: u32, q: u32) -> f32 {
    return 0.5 * dot(grad_at(p) + grad_at(q), seen_at(p) - seen_at(q));
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let k = linear_index(id, groups, 64u);
    if k >= count[0] {
        return;
    }
    let p = borders[k];
    let x = p % params.width;
    let y = p / params.width;
    var g = vec2<f32>(0.0);
    if x + 1u < params.width && occludes(p, p + 1u) {
        g.x += gain(p, p + 1u);
    }
    if x > 0u && occludes(p, p - 1u) {
        g.x -= gain(p, p - 1u);
    }
    if y + 1u < params.height && occludes(p, p + params.width) {
        g.y += gain(p, p + params.width);
    }
    if y > 0u && occludes(p, p - params.width) {
        g.y -= gain(p, p - params.width);
    }
    grad_screen[p] = g;
}
