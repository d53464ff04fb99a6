// Pass 2, one workgroup: sums = (intersection, union), losses[slot] += 1 - intersection/union.
#import shared/workgroup_sum

struct Params {
    n_partials: u32,
    slot: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> partials: array<vec2<f32>>;
@group(0) @binding(2) var<storage, read_write> sums: array<f32>;
@group(0) @binding(3) var<storage, read_write> losses: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) lane: u32) {
    var own = vec2<f32>(0.0);
    for (var i = lane; i < params.n_partials; i += 256u) {
        own += partials[i];
    }
    let intersection = workgroup_sum(lane, own.x);
    let total = workgroup_sum(lane, own.y);
    if lane == 0u {
        sums[0] = intersection;
        sums[1] = total;
        if total > 0.0 {
            losses[params.slot] += 1.0 - intersection / total;
        }
    }
}
