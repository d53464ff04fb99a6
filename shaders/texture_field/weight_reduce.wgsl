// Adds the chunks' partial sums to grad_weights, in the chunks' order.
#const CHUNK: u32 = 256u

struct Params {
    n_max: u32,
    weights4: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> count: array<u32>;
@group(0) @binding(2) var<storage, read> partial: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> grad_weights: array<vec4<f32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= params.weights4 {
        return;
    }
    let chunks = (min(params.n_max, count[0]) + CHUNK - 1u) / CHUNK;
    var sum = grad_weights[id.x];
    for (var k = 0u; k < chunks; k++) {
        sum += partial[k * params.weights4 + id.x];
    }
    grad_weights[id.x] = sum;
}
