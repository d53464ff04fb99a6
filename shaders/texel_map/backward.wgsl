// Adds to the sums of grad_texels and to grad_coords what grad_rgb says.
#import shared/linear_index
#import shared/exact_sum
#import shared/texel_cell

struct Params {
    n_max: u32,
    side: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> count: array<u32>;
@group(0) @binding(2) var<storage, read> coords: array<f32>;
@group(0) @binding(3) var<storage, read> texels: array<f32>;
@group(0) @binding(4) var<storage, read> grad_rgb: array<f32>;
@group(0) @binding(5) var<storage, read_write> sums: array<exact_sum>; // [S, S, 3, 2]
@group(0) @binding(6) var<storage, read_write> grad_coords: array<f32>;

#exact_sum sums

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let k = linear_index(id, groups, 64u);
    if k >= min(params.n_max, count[0]) {
        return;
    }
    let u = texel_cell(coords[3u * k], params.side);
    let v = texel_cell(coords[3u * k + 1u], params.side);
    let at = 3u * texel_corners(u.lower, v.lower, params.side);
    let w = texel_weights(u.part, v.part);
    var grad = vec2<f32>(0.0);
    for (var c = 0u; c < 3u; c++) {
        let upstream = grad_rgb[3u * k + c];
        if upstream == 0.0 {
            continue;
        }
        sums_add(at.x + c, w.x * upstream);
        sums_add(at.y + c, w.y * upstream);
        sums_add(at.z + c, w.z * upstream);
        sums_add(at.w + c, w.w * upstream);
        let t = vec4<f32>(texels[at.x + c], texels[at.y + c], texels[at.z + c], texels[at.w + c]);
        grad.x += upstream * mix(t.y - t.x, t.w - t.z, v.part);
        grad.y += upstream * mix(t.z - t.x, t.w - t.y, u.part);
    }
    grad_coords[3u * k] += grad.x * u.slope;
    grad_coords[3u * k + 1u] += grad.y * v.slope;
}
