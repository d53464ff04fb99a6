// One pixel that shows a face an invocation: lists the pixels that may end before a neighbour, for `edge_gradient/screen`
// and `nmr/screen`. They are few, and what is done for them is long. The order is that of arrival; each writes its own result.
#import shared/linear_index

struct Params {
    width: u32,
    height: u32,
    // Metres.
    min_step: f32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> zbuf: array<f32>; // -1 where nothing is
@group(0) @binding(2) var<storage, read> counts: array<u32>; // of pixels, of faces
@group(0) @binding(3) var<storage, read> owned: array<u32>;
@group(0) @binding(4) var<storage, read_write> count: array<atomic<u32>>;
@group(0) @binding(5) var<storage, read_write> borders: array<u32>;

fn ends(z: f32, q: u32) -> bool {
    let beyond = zbuf[q];
    return beyond < 0.0 || beyond - z > params.min_step;
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let k = linear_index(id, groups, 64u);
    if k >= counts[0] {
        return;
    }
    let p = owned[k];
    let z = zbuf[p];
    let x = p % params.width;
    let y = p / params.width;
    // A pixel at the image's border has itself for a neighbour there.
    let left = p - min(x, 1u);
    let right = p + min(params.width - 1u - x, 1u);
    let above = p - params.width * min(y, 1u);
    let below = p + params.width * min(params.height - 1u - y, 1u);
    if ends(z, left) || ends(z, right) || ends(z, above) || ends(z, below) {
        borders[atomicAdd(&count[0], 1u)] = p;
    }
}
