// Pass 1: one partial sum a workgroup of the intersection alpha S and the union alpha + S - alpha S.
#import shared/target_pixel
#import shared/workgroup_sum

struct Params {
    n_pixels: u32,
    offset: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> alpha: array<f32>;
@group(0) @binding(2) var<storage, read> seen: array<u32>;
@group(0) @binding(3) var<storage, read_write> partials: array<vec2<f32>>;

@compute @workgroup_size(256)
fn main(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    var both = 0.0;
    var any = 0.0;
    for (var i = group.x * 256u + lane; i < params.n_pixels; i += groups.x * 256u) {
        let a = alpha[i];
        let s = target_mask(params.offset + i);
        both += a * s;
        any += a + s - a * s;
    }
    let intersection = workgroup_sum(lane, both);
    let total = workgroup_sum(lane, any);
    if lane == 0u {
        partials[group.x] = vec2<f32>(intersection, total);
    }
}
