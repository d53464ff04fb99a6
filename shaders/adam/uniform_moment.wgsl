// The one second moment of uniform Adam: exp_avg_sq <- beta2 exp_avg_sq + (1 - beta2) max_i |g_i|^2, over vertices i.
// One workgroup.

struct Params {
    n_vertices: u32,
    beta2: f32,
}

const SIZE: u32 = 256u;

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> grads: array<f32>; // [V, 3]
@group(0) @binding(2) var<storage, read_write> exp_avg_sq: array<f32>; // [1]

var<workgroup> largest: array<f32, SIZE>;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) lane: u32) {
    var own = 0.0;
    for (var i = lane; i < params.n_vertices; i += SIZE) {
        let g = vec3(grads[3u * i], grads[3u * i + 1u], grads[3u * i + 2u]);
        own = max(own, dot(g, g));
    }
    largest[lane] = own;
    workgroupBarrier();
    if lane == 0u {
        var all = 0.0;
        for (var k = 0u; k < SIZE; k++) {
            all = max(all, largest[k]);
        }
        exp_avg_sq[0] = params.beta2 * exp_avg_sq[0] + (1.0 - params.beta2) * all;
    }
}
