// result[slot] += the sum of values[0 .. len], in one workgroup; see src/ops/reduce.rs.
#import shared/workgroup_sum

struct Params {
    len: u32,
    slot: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> values: array<f32>;
@group(0) @binding(2) var<storage, read_write> result: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) lane: u32) {
    var sum = 0.0;
    for (var i = lane; i < params.len; i += 256u) {
        sum += values[i];
    }
    let total = workgroup_sum(lane, sum);
    if lane == 0u {
        result[params.slot] += total;
    }
}
