// Pass 1 where the device can raise 64-bit numbers, one face an invocation: the nearest face of each pixel, of those at one
// depth the smallest index. High word: the depth's bits, inverted; low word: n_faces - index. Zero means none.
#import shared/linear_index
#import shared/hard_triangle

@group(0) @binding(0) var<uniform> params: HardParams;
@group(0) @binding(1) var<storage, read> view: array<f32>;
@group(0) @binding(2) var<storage, read> faces: array<u32>;
@group(0) @binding(3) var<storage, read_write> nearest: array<atomic<u64>>;

fn swapped(v: vec2<u32>) -> vec2<u32> {
    return select(v, v.yx, v.y < v.x);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let f = linear_index(id, groups, 64u);
    if f >= params.n_faces {
        return;
    }
    // The corners in rising order, so that faces of the same corners round their depths alike; where that turns the face
    // over, `side` turns it back.
    let i = vec3<u32>(faces[3u * f], faces[3u * f + 1u], faces[3u * f + 2u]);
    let low = swapped(i.xy);
    let high = swapped(vec2<u32>(low.y, i.z));
    let front = swapped(vec2<u32>(low.x, high.x));
    let turns = u32(i.y < i.x) + u32(i.z < low.y) + u32(high.x < low.x);
    let side = select(1.0, -1.0, turns % 2u == 1u);
    let t = Triangle(vertex_at(front.x), vertex_at(front.y), vertex_at(high.y));
    if is_culled(t, side) {
        return;
    }
    var walk = walk_of(t);
    while walk_goes_on(walk) {
        var m = meet(t, ray_at(walk.at.x, walk.at.y));
        m.d *= side;
        m.total *= side;
        if walk_meets(walk) && covers(m) {
            let key = (u64(~bitcast<u32>(depth_of(t, m))) << 32u) | u64(params.n_faces - f);
            atomicMax(&nearest[u32(walk.at.y) * params.width + u32(walk.at.x)], key);
        }
        walk = walk_next(walk);
    }
}
