// grad_rotations[9 + k] += posedirs[k] · grad_v_posed; one workgroup a feature.
#import shared/workgroup_sum

struct Params {
    len: u32, // 3V
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> posedirs: array<f32>; // [23 · 9, 3V]
@group(0) @binding(2) var<storage, read> grad_v_posed: array<f32>;
@group(0) @binding(3) var<storage, read_write> grad_rotations: array<f32>; // [24, 3, 3]

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3<u32>) {
    let k = group.x;
    var sum = 0.0;
    for (var i = lane; i < params.len; i += 256u) {
        sum += posedirs[k * params.len + i] * grad_v_posed[i];
    }
    let total = workgroup_sum(lane, sum);
    if lane == 0u {
        grad_rotations[9u + k] += total;
    }
}
