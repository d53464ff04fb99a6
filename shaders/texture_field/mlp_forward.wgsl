// rgb[p] = sigmoid(W2 · relu(W1 · relu(W0 · encoded[p]))). Weights are input-major with outputs in vec4s, so that one
// input's products with all outputs lie side by side; the outer products over them are unrolled by text.
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
@group(0) @binding(3) var<storage, read> encoded: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> hidden0: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> hidden1: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> rgb: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let p = linear_index(id, groups, 64u);
    if p >= min(params.n_max, count[0]) {
        return;
    }
#for J in 0..HIDDEN4
    var a$J = vec4<f32>(0.0);
    var b$J = vec4<f32>(0.0);
#end
#for I in 0..ENCODED4
    let x$I = encoded[p * ENCODED4 + $Iu];
    #for C in 0..4
        #for J in 0..HIDDEN4
    a$J = fma(vec4<f32>(x$I[$C]), weights[($Iu * 4u + $Cu) * HIDDEN4 + $Ju], a$J);
        #end
    #end
#end
#for I in 0..HIDDEN4
    let h$I = max(a$I, vec4<f32>(0.0));
    hidden0[p * HIDDEN4 + $Iu] = h$I;
    #for C in 0..4
        #for J in 0..HIDDEN4
    b$J = fma(vec4<f32>(h$I[$C]), weights[W1 + ($Iu * 4u + $Cu) * HIDDEN4 + $Ju], b$J);
        #end
    #end
#end
    var s = vec4<f32>(0.0);
#for I in 0..HIDDEN4
    let g$I = max(b$I, vec4<f32>(0.0));
    hidden1[p * HIDDEN4 + $Iu] = g$I;
    #for C in 0..4
    s = fma(vec4<f32>(g$I[$C]), weights[W2 + $Iu * 4u + $Cu], s);
    #end
#end
    let color = 1.0 / (1.0 + exp(-s));
    rgb[3u * p] = color.x;
    rgb[3u * p + 1u] = color.y;
    rgb[3u * p + 2u] = color.z;
}
