// rgb[k] = bilinear lookup of the texels at coords[k].
#import shared/linear_index
#import shared/texel_cell

struct Params {
    n_max: u32,
    side: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> count: array<u32>;
@group(0) @binding(2) var<storage, read> coords: array<f32>;
@group(0) @binding(3) var<storage, read> texels: array<f32>;
@group(0) @binding(4) var<storage, read_write> rgb: array<f32>;

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
    for (var c = 0u; c < 3u; c++) {
        rgb[3u * k + c] = dot(w, vec4<f32>(texels[at.x + c], texels[at.y + c], texels[at.z + c], texels[at.w + c]));
    }
}
