// Adds the chunks' partial sums to grad_weights, always in the same order: SHARERS invocations take every SHARERS-th chunk of
// the same four weights.
#const CHUNK: u32 = 256u
#const SHARERS: u32 = 1u
#const LANES: u32 = 64u

const PER_GROUP: u32 = LANES / SHARERS;

struct Params {
    n_max: u32,
    weights4: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> count: array<u32>;
@group(0) @binding(2) var<storage, read> partial: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> grad_weights: array<vec4<f32>>;

var<workgroup> sums: array<vec4<f32>, LANES>;

@compute @workgroup_size(LANES)
fn main(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3<u32>) {
    let at = group.x * PER_GROUP + lane % PER_GROUP;
    let chunks = (min(params.n_max, count[0]) + CHUNK - 1u) / CHUNK;
    var sum = vec4<f32>(0.0);
    if at < params.weights4 {
        for (var k = lane / PER_GROUP; k < chunks; k += SHARERS) {
            sum += partial[k * params.weights4 + at];
        }
    }
    sums[lane] = sum;
    workgroupBarrier();
    if lane >= PER_GROUP || at >= params.weights4 {
        return;
    }
    var total = grad_weights[at];
    for (var k = 0u; k < SHARERS; k++) {
        total += sums[k * PER_GROUP + lane];
    }
    grad_weights[at] = total;
}
