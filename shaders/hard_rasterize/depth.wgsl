// Pass 1a where the device cannot raise 64-bit numbers, one face an invocation: the nearest depth of each pixel. Stored as
// ~bits, so that zero means none.
#import shared/linear_index
#import shared/hard_triangle

@group(0) @binding(0) var<uniform> params: HardParams;
@group(0) @binding(1) var<storage, read> view: array<f32>;
@group(0) @binding(2) var<storage, read> faces: array<u32>;
@group(0) @binding(3) var<storage, read_write> nearest: array<atomic<u32>>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let f = linear_index(id, groups, 64u);
    if f >= params.n_faces {
        return;
    }
    let t = triangle_at(f);
    if is_culled(t, 1.0) {
        return;
    }
    var walk = walk_of(t);
    while walk_goes_on(walk) {
        let m = meet(t, ray_at(walk.at.x, walk.at.y));
        if walk_meets(walk) && covers(m) {
            let pixel = u32(walk.at.y) * params.width + u32(walk.at.x);
            atomicMax(&nearest[pixel], ~bitcast<u32>(depth_of(t, m)));
        }
        walk = walk_next(walk);
    }
}
