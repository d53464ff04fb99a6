// Pass 3, one pixel an invocation: what its owner shows there. Leaves `nearest` and `owner` zero for the next image.
#import shared/linear_index
#import shared/hard_triangle

@group(0) @binding(0) var<uniform> params: HardParams;
@group(0) @binding(1) var<storage, read> view: array<f32>;
@group(0) @binding(2) var<storage, read> faces: array<u32>;
@group(0) @binding(3) var<storage, read_write> nearest: array<u32>;
@group(0) @binding(4) var<storage, read_write> owner: array<u32>;
@group(0) @binding(5) var<storage, read_write> pix_to_face: array<i32>;
@group(0) @binding(6) var<storage, read_write> bary_coords: array<f32>;
@group(0) @binding(7) var<storage, read_write> zbuf: array<f32>;
@group(0) @binding(8) var<storage, read_write> alpha: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let pixel = linear_index(id, groups, 64u);
    if pixel >= params.width * params.height {
        return;
    }
    let owned = owner[pixel];
    owner[pixel] = 0u;
    nearest[pixel] = 0u;
    var bary = vec3<f32>(0.0);
    var z = -1.0;
    if owned > 0u {
        let t = triangle_at(params.n_faces - owned);
        let m = meet(t, ray_at(i32(pixel % params.width), i32(pixel / params.width)));
        bary = m.d / m.total;
        z = depth_of(t, m);
    }
    pix_to_face[pixel] = select(-1, i32(params.n_faces - owned), owned > 0u);
    alpha[pixel] = select(0.0, 1.0, owned > 0u);
    bary_coords[3u * pixel] = bary.x;
    bary_coords[3u * pixel + 1u] = bary.y;
    bary_coords[3u * pixel + 2u] = bary.z;
    zbuf[pixel] = z;
}
