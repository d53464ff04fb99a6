// Sixteen independent chains of fused multiply-adds in registers: what the device's arithmetic gives at best.
#const ROUNDS: u32 = 64u
#const CHAINS: u32 = 4u

struct Params {
    factor: f32, // below 1, so that nothing overflows
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> sums: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let factor = vec4<f32>(params.factor);
    let start = vec4<f32>(f32(id.x), 1.0, 2.0, 3.0);
#for C in 0..CHAINS
    var x$C = start + $C.0;
#end
    for (var k = 0u; k < ROUNDS; k++) {
#for R in 0..8
    #for C in 0..CHAINS
        x$C = fma(x$C, factor, start);
    #end
#end
    }
    var sum = vec4<f32>(0.0);
#for C in 0..CHAINS
    sum += x$C;
#end
    sums[id.x] = sum.x + sum.y + sum.z + sum.w;
}
