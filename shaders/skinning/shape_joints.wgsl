// j_shaped = j_template + j_shapedirs · betas; one invocation a coordinate of the 24 joints.
struct Params {
    len: u32, // 3 · 24
    n_betas: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> j_template: array<f32>;
@group(0) @binding(2) var<storage, read> j_shapedirs: array<f32>; // [B, 72]
@group(0) @binding(3) var<storage, read> betas: array<f32>;
@group(0) @binding(4) var<storage, read_write> j_shaped: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = id.x;
    if i >= params.len {
        return;
    }
    var value = j_template[i];
    for (var b = 0u; b < params.n_betas; b++) {
        value += j_shapedirs[b * params.len + i] * betas[b];
    }
    j_shaped[i] = value;
}
