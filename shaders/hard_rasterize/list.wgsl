// Pass 2, four pixels an invocation: which face owns each, and the list of the pixels that have one. What is beyond the
// last pixel may be written, and is not listed. The order of the list is that of arrival; each writes its own result.
#import shared/linear_index
#import shared/owners

@group(0) @binding(0) var<uniform> params: OwnersParams;
@group(0) @binding(1) var<storage, read> owners: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read_write> pix_to_face: array<vec4<i32>>;
@group(0) @binding(3) var<storage, read_write> zbuf: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> counts: array<atomic<u32>>; // of pixels, of faces
@group(0) @binding(5) var<storage, read_write> owned: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let k = linear_index(id, groups, 64u);
    if 4u * k >= params.n_pixels {
        return;
    }
    let owner = owners_at(k);
    pix_to_face[k] = faces_of(owner);
    zbuf[k] = vec4<f32>(-1.0);
    let pixels = 4u * k + vec4<u32>(0u, 1u, 2u, 3u);
    let shown = (owner > vec4<u32>(0u)) & (pixels < vec4<u32>(params.n_pixels));
    let ones = select(vec4<u32>(0u), vec4<u32>(1u), shown);
    let n = ones.x + ones.y + ones.z + ones.w;
    if n > 0u {
        var at = atomicAdd(&counts[0], n);
#for J in 0..4
        if shown[$J] {
            owned[at] = pixels[$J];
        }
        at += ones[$J];
#end
    }
}
