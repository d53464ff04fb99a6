// partial[chunk][input][output] = Σ over the chunk's pixels of inputs[p][input] · deltas[p][output]. An invocation sums
// one tile of TILE_I · TILE_O vec4s over one chunk, in pixel order: the result does not depend on timing.
#const INPUTS4: u32 = 8u
#const OUTPUTS4: u32 = 8u
#const TILE_I: u32 = 2u
#const TILE_O: u32 = 2u
#const CHUNK: u32 = 256u
#const LANES: u32 = 8u

// The host chooses tiles that divide the layer.
const TILES_O: u32 = OUTPUTS4 / TILE_O;
const TILES_I: u32 = INPUTS4 / TILE_I;

struct Params {
    n_max: u32,
    weights4: u32, // vec4s of all layers' weights
    offset4: u32,  // this layer's first
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> count: array<u32>;
@group(0) @binding(2) var<storage, read> inputs: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> deltas: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> partial: array<vec4<f32>>;

@compute @workgroup_size(LANES)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let first = id.y * CHUNK;
    let end = min(first + CHUNK, min(params.n_max, count[0]));
    if id.x >= TILES_I * TILES_O || first >= end {
        return;
    }
    let i0 = id.x / TILES_O * TILE_I;
    let o0 = id.x % TILES_O * TILE_O;
#for I in 0..TILE_I
    #for C in 0..4
        #for O in 0..TILE_O
    var sum_$I_$C_$O = vec4<f32>(0.0);
        #end
    #end
#end
    for (var p = first; p < end; p++) {
#for O in 0..TILE_O
        let d$O = deltas[p * OUTPUTS4 + o0 + $Ou];
#end
#for I in 0..TILE_I
        let x$I = inputs[p * INPUTS4 + i0 + $Iu];
    #for C in 0..4
        #for O in 0..TILE_O
        sum_$I_$C_$O = fma(vec4<f32>(x$I[$C]), d$O, sum_$I_$C_$O);
        #end
    #end
#end
    }
    let base = id.y * params.weights4 + params.offset4;
#for I in 0..TILE_I
    #for C in 0..4
        #for O in 0..TILE_O
    partial[base + ((i0 + $Iu) * 4u + $Cu) * OUTPUTS4 + o0 + $Ou] = sum_$I_$C_$O;
        #end
    #end
#end
}
