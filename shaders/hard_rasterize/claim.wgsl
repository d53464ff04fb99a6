// Pass 1b after `depth`, one face an invocation: of the faces at the nearest depth of a pixel, the smallest index owns it. A few units
// in the last place count as the same depth, because two kernels may round one expression differently.
// Stored as n_faces - index, so that zero means none.
#import shared/linear_index
#import shared/hard_triangle

const SAME_DEPTH_ULPS: u32 = 4u;

@group(0) @binding(0) var<uniform> params: HardParams;
@group(0) @binding(1) var<storage, read> view: array<f32>;
@group(0) @binding(2) var<storage, read> faces: array<u32>;
@group(0) @binding(3) var<storage, read> nearest: array<u32>;
@group(0) @binding(4) var<storage, read_write> owner: array<atomic<u32>>;

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
        let pixel = u32(walk.at.y) * params.width + u32(walk.at.x);
        if walk_meets(walk) && covers(m) && ~bitcast<u32>(depth_of(t, m)) + SAME_DEPTH_ULPS >= nearest[pixel] {
            atomicMax(&owner[pixel], params.n_faces - f);
        }
        walk = walk_next(walk);
    }
}
