// The derivative of the loss by each layer's sum (delta) and by encoded, from grad_rgb. Pixels without a gradient get
// zeros, because the weights' gradient reads every listed pixel.
#import shared/linear_index
#const ENCODED4: u32 = 6u
#const HIDDEN4: u32 = 8u

const W1: u32 = 4u * ENCODED4 * HIDDEN4;
const W2: u32 = W1 + 4u * HIDDEN4 * HIDDEN4;

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

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let p = linear_index(id, groups, 64u);
    if p >= min(params.n_max, count[0]) {
        return;
    }
    let color = vec4<f32>(rgb[3u * p], rgb[3u * p + 1u], rgb[3u * p + 2u], 0.0);
    let upstream = vec4<f32>(grad_rgb[3u * p], grad_rgb[3u * p + 1u], grad_rgb[3u * p + 2u], 0.0);
    let d2 = upstream * color * (1.0 - color);
    delta2[p] = d2;
#for I in 0..HIDDEN4
    let s$I = vec4<f32>(
        dot(weights[W2 + $Iu * 4u], d2),
        dot(weights[W2 + $Iu * 4u + 1u], d2),
        dot(weights[W2 + $Iu * 4u + 2u], d2),
        dot(weights[W2 + $Iu * 4u + 3u], d2));
    let d1_$I = select(vec4<f32>(0.0), s$I, hidden1[p * HIDDEN4 + $Iu] > vec4<f32>(0.0));
    delta1[p * HIDDEN4 + $Iu] = d1_$I;
#end
#for I in 0..HIDDEN4
    var t$I = vec4<f32>(0.0);
    #for C in 0..4
    {
        var sum = vec4<f32>(0.0);
        #for J in 0..HIDDEN4
        sum = fma(weights[W1 + ($Iu * 4u + $Cu) * HIDDEN4 + $Ju], d1_$J, sum);
        #end
        t$I[$C] = (sum.x + sum.y) + (sum.z + sum.w);
    }
    #end
    let d0_$I = select(vec4<f32>(0.0), t$I, hidden0[p * HIDDEN4 + $Iu] > vec4<f32>(0.0));
    delta0[p * HIDDEN4 + $Iu] = d0_$I;
#end
#for I in 0..ENCODED4
    {
        var g = vec4<f32>(0.0);
    #for C in 0..4
        {
            var sum = vec4<f32>(0.0);
        #for J in 0..HIDDEN4
            sum = fma(weights[($Iu * 4u + $Cu) * HIDDEN4 + $Ju], d0_$J, sum);
        #end
            g[$C] = (sum.x + sum.y) + (sum.z + sum.w);
        }
    #end
        grad_encoded[p * ENCODED4 + $Iu] = g;
    }
#end
}
