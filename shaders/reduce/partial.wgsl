// One partial sum a workgroup over values[0 .. len]; see src/ops/reduce.rs.
#import shared/workgroup_sum

struct Params {
    len: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> values: array<f32>;
@group(0) @binding(2) var<storage, read_write> partials: array<f32>;

@compute @workgroup_size(256)
fn main(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    var sum = 0.0;
    for (var i = group.x * 256u + lane; i < params.len; i += groups.x * 256u) {
        sum += values[i];
    }
    let total = workgroup_sum(lane, sum);
    if lane == 0u {
        partials[group.x] = total;
    }
}
