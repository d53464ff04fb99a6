// One listed pixel an invocation: grad_screen [H, W, 2], the pull on the surface that the pixel shows, from the sweeps over
// its row and its column that start at its borders; see src/ops/nmr/mod.rs.
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

// The derivative of the loss for p's border with its neighbour in direction `step` moving that way; `ahead` and `behind`
// pixels lie before the image's borders.
fn sweep(p: u32, step: i32, ahead: u32, behind: u32) -> f32 {
    if ahead == 0u || !occludes(p, u32(i32(p) + step)) {
        return 0.0;
    }
    let within = seen_at(p);
    let without = seen_at(u32(i32(p) + step));
    var sum = 0.0;
    // Outward: pixels that would better look like p. The border lies half a pixel before p.
    for (var d = 1u; d <= min(ahead, params.max_sweep); d++) {
        let r = u32(i32(p) + i32(d) * step);
        let lowers = dot(seen_at(r) - within, grad_at(r));
        sum -= max(lowers, 0.0) / (f32(d) - 0.5);
    }
    // Inward, over the face: pixels that would better look like what lies outside.
    let face = pix_to_face[p];
    for (var d = 0u; d <= min(behind, params.max_sweep); d++) {
        let r = u32(i32(p) - i32(d) * step);
        if pix_to_face[r] != face {
            break;
        }
        let lowers = dot(seen_at(r) - without, grad_at(r));
        sum += max(lowers, 0.0) / (f32(d) + 0.5);
    }
    return sum;
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
    let row = i32(params.width);
    let right = params.width - 1u - x;
    let below = params.height - 1u - y;
    grad_screen[p] = vec2<f32>(
        sweep(p, 1, right, x) - sweep(p, -1, x, right),
        sweep(p, row, below, y) - sweep(p, -row, y, below),
    );
}
