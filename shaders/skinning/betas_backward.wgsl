// grad_betas[b] += shapedirs[b] · grad_v_deformed + j_shapedirs[b] · grad_j_shaped; one workgroup a component.
#import shared/workgroup_sum

struct Params {
    len: u32, // 3V
    joints_len: u32, // 3 · 24
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> shapedirs: array<f32>; // [B, 3V]
@group(0) @binding(2) var<storage, read> j_shapedirs: array<f32>; // [B, 72]
@group(0) @binding(3) var<storage, read> grad_v_deformed: array<f32>;
@group(0) @binding(4) var<storage, read> grad_j_shaped: array<f32>;
@group(0) @binding(5) var<storage, read_write> grad_betas: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3<u32>) {
    let b = group.x;
    var sum = 0.0;
    for (var i = lane; i < params.len; i += 256u) {
        sum += shapedirs[b * params.len + i] * grad_v_deformed[i];
    }
    if lane < params.joints_len {
        sum += j_shapedirs[b * params.joints_len + lane] * grad_j_shaped[lane];
    }
    let total = workgroup_sum(lane, sum);
    if lane == 0u {
        grad_betas[b] += total;
    }
}
