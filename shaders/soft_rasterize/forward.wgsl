// Pass 5, one tile a workgroup, one pixel an invocation: colour and alpha, and for the backward pass
// state = (m, 1/W, ln T): the greatest score, the inverse of W = sum exp(score - m), and T = prod (1 - D).
#import shared/soft_face

@group(0) @binding(0) var<uniform> params: SoftParams;
@group(0) @binding(1) var<storage, read> records: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> face_colours: array<f32>;
@group(0) @binding(3) var<storage, read> boxes: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read> starts: array<u32>;
@group(0) @binding(5) var<storage, read> sorted: array<u32>;
@group(0) @binding(6) var<storage, read_write> rgb: array<f32>;
@group(0) @binding(7) var<storage, read_write> alpha: array<f32>;
@group(0) @binding(8) var<storage, read_write> state: array<vec4<f32>>;

@compute @workgroup_size(64)
fn main(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let tile = group.x + group.y * groups.x;
    if tile >= params.n_tiles {
        return;
    }
    // Eight neighbouring invocations take a block of 4 x 2 pixels.
    let block = lane / 8u;
    let x = (tile % params.tiles_x) * TILE + (block % 2u) * 4u + lane % 4u;
    let y = (tile / params.tiles_x) * TILE + (block / 2u) * 2u + (lane % 8u) / 4u;
    let p = pixel_centre(i32(x), i32(y));

    var start = starts[tile];
    var end = starts[tile + 1u];
    // A list that did not fit: all faces in turn, right but slow.
    let listed = end <= params.capacity;
    if !listed {
        start = 0u;
        end = params.n_faces;
    }

    var most = params.eps / params.gamma;
    var weight = 1.0;
    var colour = vec3<f32>(params.red, params.green, params.blue);
    var log_t = 0.0;
    for (var k = start; k < end; k++) {
        var f = k;
        if listed {
            f = sorted[k];
        }
        let r1 = records[4u * f + 1u];
        // From here on no face can change this pixel: they lie behind, and it is opaque.
        if listed && log_t < -NEGLIGIBLE && nearness(r1.w) < most - NEGLIGIBLE {
            break;
        }
        let face = unpack_face(records[4u * f], r1, records[4u * f + 2u], records[4u * f + 3u]);
        let r = fragment_at(face, p);
        let drawn = listed || (boxes[f].x & 0xffffu) <= (boxes[f].x >> 16u);
        if r.counts && drawn {
            let rest = soft_rest(r.x);
            log_t -= rest + max(r.x, 0.0);
            let score = nearness(r.z) - rest - max(-r.x, 0.0);
            let e = exp(-abs(score - most));
            let higher = score > most;
            let keep = select(1.0, e, higher);
            let share = select(e, 1.0, higher);
            let own = vec3<f32>(face_colours[3u * f], face_colours[3u * f + 1u], face_colours[3u * f + 2u]);
            weight = weight * keep + share;
            colour = colour * keep + own * share;
            most = max(most, score);
        }
    }
    if x >= params.width || y >= params.height {
        return;
    }
    let pixel = y * params.width + x;
    rgb[3u * pixel] = colour.x / weight;
    rgb[3u * pixel + 1u] = colour.y / weight;
    rgb[3u * pixel + 2u] = colour.z / weight;
    // 1 - exp(log_t) without cancellation.
    let series = -log_t * (1.0 + 0.5 * log_t * (1.0 + log_t / 3.0));
    alpha[pixel] = select(1.0 - exp(log_t), series, log_t > -0.01);
    state[pixel] = vec4<f32>(most, 1.0 / weight, log_t, 0.0);
}
