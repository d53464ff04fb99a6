// Pass 4, one tile a workgroup: colour and alpha, and for the backward pass state = (ln W, ln T): W = sum exp(score), T = prod (1 - D).
//
// Each invocation takes every LANES-th face of the tile's list and keeps its share of all the tile's pixels in
// registers, because fetching a face costs as much as testing it against ten pixels; the shares are merged at the end.
// A list that did not fit is replaced by all faces: slow, and right.
#import shared/soft_face

#const LANES: u32 = 32u

struct Share {
    most: f32,
    weight: f32,
    log_t: f32,
    colour: vec3<f32>,
}

@group(0) @binding(0) var<uniform> params: SoftParams;
@group(0) @binding(1) var<storage, read> records: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> face_colours: array<f32>;
@group(0) @binding(3) var<storage, read> starts: array<u32>;
@group(0) @binding(4) var<storage, read> entries: array<u32>;
@group(0) @binding(5) var<storage, read_write> rgb: array<f32>;
@group(0) @binding(6) var<storage, read_write> alpha: array<f32>;
@group(0) @binding(7) var<storage, read_write> state: array<vec2<f32>>;

// (most, weight, log_t, red) and (green, blue) of each pixel and invocation.
var<workgroup> shares: array<vec4<f32>, TILE_PIXELS * LANES>;
var<workgroup> shares_gb: array<vec2<f32>, TILE_PIXELS * LANES>;

fn add(share: Share, face: SoftFace, own: vec3<f32>, p: vec2<f32>) -> Share {
    let r = fragment_at(face, p);
    let rest = soft_rest(r.x);
    let score = select(-3e38, nearness(r.z) - rest - max(-r.x, 0.0), r.counts);
    let e = exp(-abs(score - share.most));
    let higher = score > share.most;
    let keep = select(1.0, e, higher);
    let gain = select(e, 1.0, higher);
    let log_t = share.log_t - select(0.0, rest + max(r.x, 0.0), r.counts);
    return Share(max(score, share.most), share.weight * keep + gain, log_t, share.colour * keep + own * gain);
}

fn merge(a: Share, b: Share) -> Share {
    let most = max(a.most, b.most);
    let ka = exp(a.most - most);
    let kb = exp(b.most - most);
    return Share(most, a.weight * ka + b.weight * kb, a.log_t + b.log_t, a.colour * ka + b.colour * kb);
}

@compute @workgroup_size(LANES)
fn main(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let tile = group.x + group.y * groups.x;
    if tile >= params.n_tiles {
        return;
    }
    let x0 = (tile % params.tiles_x) * TILE;
    let y0 = (tile / params.tiles_x) * TILE;
    let origin = pixel_centre(i32(x0), i32(y0));
    let step = 1.0 / params.norm_px;

    var own_shares: array<Share, TILE_PIXELS>;
    for (var i = 0u; i < TILE_PIXELS; i++) {
        // Less than any score, and more than the score of a fragment that does not count.
        own_shares[i] = Share(-1e38, 0.0, 0.0, vec3<f32>(0.0));
    }
    var start = starts[tile];
    var end = starts[tile + 1u];
    let listed = end <= params.capacity;
    if !listed {
        start = 0u;
        end = params.n_faces;
    }
    for (var k = start + lane; k < end; k += LANES) {
        var f = k;
        if listed {
            f = entries[k];
        }
        let face = unpack_face(records[4u * f], records[4u * f + 1u], records[4u * f + 2u], records[4u * f + 3u]);
        let own = vec3<f32>(face_colours[3u * f], face_colours[3u * f + 1u], face_colours[3u * f + 2u]);
        for (var i = 0u; i < TILE_PIXELS; i++) {
            own_shares[i] = add(own_shares[i], face, own, origin + step * vec2<f32>(f32(i % TILE), f32(i / TILE)));
        }
    }
    // Nothing to merge in a tile without faces.
    let sharers = min(end - start, LANES);
    if sharers > 0u {
        for (var i = 0u; i < TILE_PIXELS; i++) {
            let s = own_shares[i];
            shares[i * LANES + lane] = vec4<f32>(s.most, s.weight, s.log_t, s.colour.x);
            shares_gb[i * LANES + lane] = s.colour.yz;
        }
    }
    workgroupBarrier();
    for (var i = lane; i < TILE_PIXELS; i += LANES) {
        let x = x0 + i % TILE;
        let y = y0 + i / TILE;
        if x < params.width && y < params.height {
            var s = Share((params.eps - 1.0) / params.gamma, 1.0, 0.0, vec3<f32>(params.red, params.green, params.blue));
            for (var j = 0u; j < sharers; j++) {
                let a = shares[i * LANES + j];
                s = merge(s, Share(a.x, a.y, a.z, vec3<f32>(a.w, shares_gb[i * LANES + j])));
            }
            let pixel = y * params.width + x;
            rgb[3u * pixel] = s.colour.x / s.weight;
            rgb[3u * pixel + 1u] = s.colour.y / s.weight;
            rgb[3u * pixel + 2u] = s.colour.z / s.weight;
            // 1 - exp(log_t) without cancellation.
            let series = -s.log_t * (1.0 + 0.5 * s.log_t * (1.0 + s.log_t / 3.0));
            alpha[pixel] = select(1.0 - exp(s.log_t), series, s.log_t > -0.01);
            state[pixel] = vec2<f32>(s.most + log(s.weight), s.log_t);
        }
    }
}
