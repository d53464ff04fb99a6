// rgb[p] = sigmoid(W2 · relu(W1 · relu(W0 · encoded[p]))), one invocation a pixel. The weights are input-major with the
// outputs in vec4s, so that one input's products with all outputs lie side by side. A workgroup copies them first; all
// reads of the copy are at constant addresses and outside of branches, which a software driver needs to read one value
// for all its lanes. Therefore lanes past the list's end compute its last pixel again and store nothing.
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
@group(0) @binding(3) var<storage, read> encoded: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> hidden0: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> hidden1: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> rgb: array<f32>;

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

#for J in 0..HIDDEN4
    var a$J = vec4<f32>(0.0);
    var b$J = vec4<f32>(0.0);
#end
#for I in 0..ENCODED4
    let x$I = encoded[p * ENCODED4 + $Iu];
    #for C in 0..4
        #for J in 0..HIDDEN4
    a$J = fma(vec4<f32>(x$I[$C]), w[($Iu * 4u + $Cu) * HIDDEN4 + $Ju], a$J);
        #end
    #end
#end
#for I in 0..HIDDEN4
    a$I = max(a$I, vec4<f32>(0.0));
    #for C in 0..4
        #for J in 0..HIDDEN4
    b$J = fma(vec4<f32>(a$I[$C]), w[W1 + ($Iu * 4u + $Cu) * HIDDEN4 + $Ju], b$J);
        #end
    #end
#end
    var s = vec4<f32>(0.0);
#for I in 0..HIDDEN4
    b$I = max(b$I, vec4<f32>(0.0));
    #for C in 0..4
    s = fma(vec4<f32>(b$I[$C]), w[W2 + $Iu * 4u + $Cu], s);
    #end
#end
    let color = 1.0 / (1.0 + exp(-s));

    if index >= n {
        return;
    }
#for I in 0..HIDDEN4
    hidden0[p * HIDDEN4 + $Iu] = a$I;
    hidden1[p * HIDDEN4 + $Iu] = b$I;
#end
    rgb[3u * p] = color.x;
    rgb[3u * p + 1u] = color.y;
    rgb[3u * p + 2u] = color.z;
}
