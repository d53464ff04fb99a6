// Backward pass 1, one tile with a list a workgroup, a pixel an invocation: what faces read there, (g, ln W) with
// g = dL/drgb and (g.rgb, T dL/dalpha).
#import shared/soft_face

// Whether alpha has a gradient.
#const COVERAGE: bool = true

@group(0) @binding(0) var<uniform> params: SoftParams;
@group(0) @binding(1) var<storage, read> state: array<vec2<f32>>;
@group(0) @binding(2) var<storage, read> rgb: array<f32>;
@group(0) @binding(3) var<storage, read> grad_rgb: array<f32>;
@group(0) @binding(4) var<storage, read> grad_alpha: array<f32>;
@group(0) @binding(5) var<storage, read_write> pixels: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> pixels_rest: array<vec2<f32>>;
@group(0) @binding(7) var<storage, read> busy: array<u32>;

@compute @workgroup_size(TILE_PIXELS)
fn main(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let place = group.x + group.y * groups.x;
    if place >= busy[0] {
        return;
    }
    let tile = busy[1u + place];
    let x = (tile % params.tiles_x) * TILE + lane % TILE;
    let y = (tile / params.tiles_x) * TILE + lane / TILE;
    if x >= params.width || y >= params.height {
        return;
    }
    let i = y * params.width + x;
    let s = state[i];
    let g = vec3<f32>(grad_rgb[3u * i], grad_rgb[3u * i + 1u], grad_rgb[3u * i + 2u]);
    let mean = dot(g, vec3<f32>(rgb[3u * i], rgb[3u * i + 1u], rgb[3u * i + 2u]));
    pixels[i] = vec4<f32>(g, s.x);
    if COVERAGE {
        pixels_rest[i] = vec2<f32>(mean, s.y * grad_alpha[i]);
    } else {
        pixels_rest[i].x = mean;
    }
}
