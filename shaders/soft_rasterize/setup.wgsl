// Pass 1, one face an invocation: its record, the box of pixels within reach, a count in each tile of the box where it
// is not hidden, and one in the class of its box.
#import shared/linear_index
#import shared/soft_face

// Whether `limits` holds how deep each tile is seen.
#const LIMITED: bool = false

// Faces thinner than this (twice the area, normalised) have no usable depth and are skipped.
const MIN_AREA: f32 = 1e-12;

@group(0) @binding(0) var<uniform> params: SoftParams;
@group(0) @binding(1) var<storage, read> view: array<f32>;
@group(0) @binding(2) var<storage, read> faces: array<u32>;
@group(0) @binding(3) var<storage, read_write> records: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> boxes: array<vec2<u32>>; // x0 | x1 << 16, y0 | y1 << 16
@group(0) @binding(5) var<storage, read_write> counts: array<atomic<u32>>; // [n_tiles], then of the drawn faces by their sizes
@group(0) @binding(6) var<storage, read> limits: array<f32>;

fn vertex_at(i: u32) -> vec3<f32> {
    return vec3<f32>(view[3u * i], view[3u * i + 1u], view[3u * i + 2u]);
}

fn project(v: vec3<f32>) -> vec2<f32> {
    let size = vec2<f32>(f32(params.width), f32(params.height));
    let shift = vec2<f32>(params.cx, params.cy) - 0.5 * size;
    return (vec2<f32>(params.fx, params.fy) * v.xy / v.z + shift) / params.norm_px;
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let f = linear_index(id, groups, 64u);
    if f >= params.n_faces {
        return;
    }
    let va = vertex_at(faces[3u * f]);
    let vb = vertex_at(faces[3u * f + 1u]);
    let vc = vertex_at(faces[3u * f + 2u]);
    let a = project(va);
    let b = project(vb);
    let c = project(vc);
    let z_min = min(va.z, min(vb.z, vc.z));
    let z_max = max(va.z, max(vb.z, vc.z));
    let area = cross2(b - a, c - a);
    let inv_length2 = 1.0 / max(vec3<f32>(dot(c - b, c - b), dot(a - c, a - c), dot(b - a, b - a)), vec3<f32>(1e-20));
    let size = vec2<f32>(f32(params.width), f32(params.height));
    let reach = sqrt(params.cut * params.sigma) + 0.01 / params.norm_px;
    let low = ceil((min(a, min(b, c)) - reach) * params.norm_px + 0.5 * size - 0.5);
    let high = floor((max(a, max(b, c)) + reach) * params.norm_px + 0.5 * size - 0.5);
    let x0 = clamp(low, vec2<f32>(0.0), size);
    let x1 = clamp(high, vec2<f32>(-1.0), size - 1.0);
    let visible = z_min > 0.0 && z_max > params.near && z_min < params.far && abs(area) > MIN_AREA
        && x0.x <= x1.x && x0.y <= x1.y;
    if !visible {
        // A record of zeros has no depth and counts nowhere.
        boxes[f] = vec2<u32>(1u, 1u);
        records[4u * f] = vec4<f32>(0.0);
        records[4u * f + 1u] = vec4<f32>(0.0);
        records[4u * f + 2u] = vec4<f32>(0.0);
        records[4u * f + 3u] = vec4<f32>(0.0);
        return;
    }
    records[4u * f] = vec4<f32>(a, b);
    records[4u * f + 1u] = vec4<f32>(c, 1.0 / area, z_min);
    records[4u * f + 2u] = vec4<f32>(1.0 / va.z, 1.0 / vb.z, 1.0 / vc.z, 0.0);
    records[4u * f + 3u] = vec4<f32>(inv_length2, 0.0);
    let first = vec2<u32>(x0);
    let last = vec2<u32>(x1);
    var seen = false;
    for (var ty = first.y / TILE; ty <= last.y / TILE; ty++) {
        for (var tx = first.x / TILE; tx <= last.x / TILE; tx++) {
            let tile = ty * params.tiles_x + tx;
            // `fill` makes the same comparison.
            if !LIMITED || z_min <= limits[tile] {
                atomicAdd(&counts[tile], 1u);
                seen = true;
            }
        }
    }
    let box = first | (last << vec2<u32>(16u));
    boxes[f] = select(vec2<u32>(1u), box, seen);
    if seen {
        atomicAdd(&counts[params.n_tiles + size_class(box_pixels(box))], 1u);
    }
}
