// v_shaped = v_template + shapedirs · betas and v_deformed = v_shaped + offsets; one invocation a coordinate.
#import shared/linear_index

struct Params {
    len: u32, // 3V
    n_betas: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> v_template: array<f32>;
@group(0) @binding(2) var<storage, read> shapedirs: array<f32>; // [B, 3V]
@group(0) @binding(3) var<storage, read> betas: array<f32>;
@group(0) @binding(4) var<storage, read> offsets: array<f32>;
@group(0) @binding(5) var<storage, read_write> v_shaped: array<f32>;
@group(0) @binding(6) var<storage, read_write> v_deformed: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let i = linear_index(id, groups, 64u);
    if i >= params.len {
        return;
    }
    var value = v_template[i];
    for (var b = 0u; b < params.n_betas; b++) {
        value += shapedirs[b * params.len + i] * betas[b];
    }
    v_shaped[i] = value;
    v_deformed[i] = value + offsets[i];
}
