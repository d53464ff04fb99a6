// Pass 3, one owned pixel an invocation: what its owner shows there, and the list of the faces that own a pixel, in the
// order of arrival.
#import shared/linear_index
#import shared/hard_triangle

@group(0) @binding(0) var<uniform> params: HardParams;
@group(0) @binding(1) var<storage, read> view: array<f32>;
@group(0) @binding(2) var<storage, read> faces: array<u32>;
@group(0) @binding(3) var<storage, read> pix_to_face: array<i32>;
@group(0) @binding(4) var<storage, read_write> bary_coords: array<f32>;
@group(0) @binding(5) var<storage, read_write> zbuf: array<f32>;
@group(0) @binding(6) var<storage, read_write> alpha: array<f32>;
@group(0) @binding(7) var<storage, read_write> counts: array<atomic<u32>>; // of pixels, of faces
@group(0) @binding(8) var<storage, read> owned: array<u32>;
@group(0) @binding(9) var<storage, read_write> owns: array<atomic<u32>>; // [F]
@group(0) @binding(10) var<storage, read_write> owners: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let k = linear_index(id, groups, 64u);
    if k >= atomicLoad(&counts[0]) {
        return;
    }
    let pixel = owned[k];
    let f = u32(pix_to_face[pixel]);
    let t = triangle_at(f);
    let m = meet(t, ray_at(i32(pixel % params.width), i32(pixel / params.width)));
    let bary = m.d / m.total;
    bary_coords[3u * pixel] = bary.x;
    bary_coords[3u * pixel + 1u] = bary.y;
    bary_coords[3u * pixel + 2u] = bary.z;
    zbuf[pixel] = depth_of(t, m);
    alpha[pixel] = 1.0;
    if atomicMax(&owns[f], 1u) == 0u {
        owners[atomicAdd(&counts[1], 1u)] = f;
    }
}
