// Backward pass 1, one pixel an invocation: what faces read there, (g, ln W) with g = dL/drgb and (g.rgb, T dL/dalpha),
// and the gate: a face whose nearness is below it has no part in the pixel.
#import shared/linear_index
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
@group(0) @binding(7) var<storage, read_write> gates: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = linear_index(id, groups, 64u);
    if i >= params.width * params.height {
        return;
    }
    let s = state[i];
    let g = vec3<f32>(grad_rgb[3u * i], grad_rgb[3u * i + 1u], grad_rgb[3u * i + 2u]);
    let mean = dot(g, vec3<f32>(rgb[3u * i], rgb[3u * i + 1u], rgb[3u * i + 2u]));
    var gate = select(s.x - NEGLIGIBLE, 3e38, all(g == vec3<f32>(0.0)));
    var g_clear = 0.0;
    if COVERAGE {
        g_clear = s.y * grad_alpha[i];
        gate = select(gate, -3e38, s.y > exp(-NEGLIGIBLE) && grad_alpha[i] != 0.0);
    }
    pixels[i] = vec4<f32>(g, s.x);
    pixels_rest[i] = vec2<f32>(mean, g_clear);
    gates[i] = gate;
}
