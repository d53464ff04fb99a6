// A tile's pixels and their shares of faces, with the bindings of the two divisions of that work; see
// src/ops/soft_rasterize/mod.rs. The importing file imports shared/soft_face.
//
// An invocation keeps its shares of all the tile's pixels in registers, because fetching a face costs as much as testing it
// against ten pixels. A list that did not fit is replaced by all faces: slow, and right.
//
// With D = exp(min(x, 0)) / (1 + exp(-|x|)) a share is exp(nearness + min(x, 0)) / (1 + exp(-|x|)): the exponent is what
// may be too great or small for a float, so the greatest of those is kept apart.

// Whether alpha is wanted.
#const COVERAGE: bool = true

@group(0) @binding(0) var<uniform> params: SoftParams;
@group(0) @binding(1) var<storage, read> records: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> face_colours: array<f32>;
@group(0) @binding(3) var<storage, read> starts: array<u32>;
@group(0) @binding(4) var<storage, read> entries: array<u32>;
@group(0) @binding(5) var<storage, read_write> rgb: array<f32>;
@group(0) @binding(6) var<storage, read_write> alpha: array<f32>;
@group(0) @binding(7) var<storage, read_write> state: array<vec2<f32>>;
@group(0) @binding(8) var<storage, read> busy: array<u32>;

struct Share {
    most: f32,
    weight: f32,
    clear: f32,
    colour: vec3<f32>,
}

// Less than any score, and more than the score of a fragment that does not count.
const NO_SHARE: Share = Share(-1e38, 0.0, 1.0, vec3<f32>(0.0));

fn add(share: Share, r: Fragment, own: vec3<f32>) -> Share {
    let e = exp(-abs(r.x));
    let inv = 1.0 / (1.0 + e);
    let score = select(-3e38, nearness(r.z) + min(r.x, 0.0), r.counts);
    let ratio = exp(-abs(score - share.most));
    let higher = score > share.most;
    let keep = select(1.0, ratio, higher);
    let gain = select(ratio, 1.0, higher) * inv;
    var clear = share.clear;
    if COVERAGE {
        clear *= select(1.0, select(1.0, e, r.x > 0.0) * inv, r.counts);
    }
    return Share(max(score, share.most), share.weight * keep + gain, clear, share.colour * keep + own * gain);
}

fn merge(a: Share, b: Share) -> Share {
    let most = max(a.most, b.most);
    let ka = exp(a.most - most);
    let kb = exp(b.most - most);
    return Share(most, a.weight * ka + b.weight * kb, a.clear * b.clear, a.colour * ka + b.colour * kb);
}

// Adds every `step`-th face of the tile's list to `shares`, from the `first` one. Returns how many faces the list has.
fn take_faces(shares: ptr<function, array<Share, TILE_PIXELS>>, tile: u32, first: u32, step: u32) -> u32 {
    let origin = pixel_centre(i32((tile % params.tiles_x) * TILE), i32((tile / params.tiles_x) * TILE));
    let pixel = params.scale / params.norm_px;
    var start = starts[tile];
    var end = starts[tile + 1u];
    let listed = end <= params.capacity;
    if !listed {
        start = 0u;
        end = params.n_faces;
    }
    for (var k = start + first; k < end; k += step) {
        var f = k;
        if listed {
            f = entries[k];
        }
        let face = unpack_face(records[4u * f], records[4u * f + 1u], records[4u * f + 2u], records[4u * f + 3u]);
        let own = vec3<f32>(face_colours[3u * f], face_colours[3u * f + 1u], face_colours[3u * f + 2u]);
        let e = edges_from(face, origin);
        let across = pixel * e.dir_x;
        let down = pixel * e.dir_y;
#for J in 0..TILE
    #for I in 0..TILE
        {
            let line = e.line + $J.0 * across - $I.0 * down;
            let along = e.along + $I.0 * across + $J.0 * down;
            let r = fragment_at(e, face.inv_z, line, along);
            shares[$Ju * TILE + $Iu] = add(shares[$Ju * TILE + $Iu], r, own);
        }
    #end
#end
    }
    return end - start;
}

// Before any face.
fn background_share() -> Share {
    return Share((params.eps - 1.0) / params.gamma, 1.0, 1.0, vec3<f32>(params.red, params.green, params.blue));
}

// Colour and alpha of the tile's `i`-th pixel, and for the backward pass state = (ln W, T): W = sum exp(score), T = prod (1 - D).
fn write_pixel(tile: u32, i: u32, s: Share) {
    let x = (tile % params.tiles_x) * TILE + i % TILE;
    let y = (tile / params.tiles_x) * TILE + i / TILE;
    if x >= params.width || y >= params.height {
        return;
    }
    let pixel = y * params.width + x;
    rgb[3u * pixel] = s.colour.x / s.weight;
    rgb[3u * pixel + 1u] = s.colour.y / s.weight;
    rgb[3u * pixel + 2u] = s.colour.z / s.weight;
    if COVERAGE {
        alpha[pixel] = 1.0 - s.clear;
    }
    state[pixel] = vec2<f32>(s.most + log(s.weight), s.clear);
}
