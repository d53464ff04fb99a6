// The derivative of the loss by each layer's sum (delta) and by encoded, from grad_rgb; one invocation a pixel. Copies and
// reads the weights as mlp_forward does, for the same reason. Pixels without a gradient get zeros, because the weights'
// gradient reads every listed pixel.
#import shared/linear_index
#const LANES: u32 = 256u
#const ENCODED4: u32 = 6u
#const HIDDEN4: u32 = 8u

const W1: u32 = 4u * ENCODED4 * HIDDEN4;
const W2: u32 = W1 + 4u * HIDDEN4 * HIDDEN4;
const WEIGHTS4: u32 = W2 + 4u * HIDDEN4;

struct Params {
    n_max: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> count: array<u32>;
@group(0) @binding(2) var<storage, read> weights: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> hidden0: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> hidden1: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> rgb: array<f32>;
@group(0) @binding(6) var<storage, read> grad_rgb: array<f32>;
@group(0) @binding(7) var<storage, read_write> delta0: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> delta1: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read_write> delta2: array<vec4<f32>>;
@group(0) @binding(10) var<storage, read_write> grad_encoded: array<vec4<f32>>;

var<workgroup> w: array<vec4<f32>, WEIGHTS4>;

@compute @workgroup_size(LANES)
fn main(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    for (var k = lane; k < WEIGHTS4; k += LANES) {
        w[k] = weights[k];
    }
    workgroupBarrier();
    let index = linear_index(id, groups, LANES);
    let n = min(params.n_max, count[0]);
    let p = min(index, max(n, 1u) - 1u);

    let color = vec4<f32>(rgb[3u * p], rgb[3u * p + 1u], rgb[3u * p + 2u], 0.0);
    let upstream = vec4<f32>(grad_rgb[3u * p], grad_rgb[3u * p + 1u], grad_rgb[3u * p + 2u], 0.0);
    let c = upstream * color * (1.0 - color);
#for I in 0..HIDDEN4
    var b$I = vec4<f32>(
    #for C in 0..4
        dot(w[W2 + $Iu * 4u + $Cu], c),
    #end
    );
    b$I = select(vec4<f32>(0.0), b$I, hidden1[p * HIDDEN4 + $Iu] > vec4<f32>(0.0));
#end
#for I in 0..HIDDEN4
    var a$I: vec4<f32>;
    #for C in 0..4
    {
        var sum = vec4<f32>(0.0);
        #for J in 0..HIDDEN4
        sum = fma(w[W1 + ($Iu * 4u + $Cu) * HIDDEN4 + $Ju], b$J, sum);
        #end
        a$I[$C] = (sum.x + sum.y) + (sum.z + sum.w);
    }
    #end
    a$I = select(vec4<f32>(0.0), a$I, hidden0[p * HIDDEN4 + $Iu] > vec4<f32>(0.0));
#end
#for I in 0..ENCODED4
    var x$I: vec4<f32>;
    #for C in 0..4
    {
        var sum = vec4<f32>(0.0);
        #for J in 0..HIDDEN4
        sum = fma(w[($Iu * 4u + $Cu) * HIDDEN4 + $Ju], a$J, sum);
        #end
        x$I[$C] = (sum.x + sum.y) + (sum.z + sum.w);
    }
    #end
#end

    if index >= n {
        return;
    }
    delta2[p] = c;
#for I in 0..HIDDEN4
    delta1[p * HIDDEN4 + $Iu] = b$I;
    delta0[p * HIDDEN4 + $Iu] = a$I;
#end
#for I in 0..ENCODED4
    grad_encoded[p * ENCODED4 + $Iu] = x$I;
#end
}
