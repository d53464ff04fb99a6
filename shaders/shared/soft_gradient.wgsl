// A face's gradient at a pixel, with the bindings of the two divisions of that work; see src/ops/soft_rasterize/mod.rs. The
// importing file imports shared/soft_face.
//
// With the score s = ln D + (z^ - 1)/gamma, weight w = exp(s)/W, D = sigmoid(x), x = +-d^2/sigma:
//   dL/ds = w (g.C - g.rgb),  dL/dx = dL/ds (1 - D) + T dL/dalpha D,  dL/dC = w g.
// d^2 = |delta|^2 with the nearest boundary point sum foot_k p_k:  dd^2/dp_k = -2 foot_k delta (the foot is optimal).
// z = 1/S with S = sum c_k (1/z_k) / sum c_k, c = clamp(w): passes where 0 < w < 1; w_k = q_i x q_j / area as in
// hard_rasterize/backward.

// Whether alpha has a gradient.
#const COVERAGE: bool = true

@group(0) @binding(0) var<uniform> params: SoftParams;
@group(0) @binding(1) var<storage, read> records: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> boxes: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read> face_colours: array<f32>;
@group(0) @binding(4) var<storage, read> pixels: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> pixels_rest: array<vec2<f32>>;
@group(0) @binding(6) var<storage, read> drawn: array<u32>;
@group(0) @binding(7) var<storage, read_write> grad_corners: array<f32>;
@group(0) @binding(8) var<storage, read_write> grad_face_colours: array<f32>;

// Sums over pixels. The gradient by the barycentric coordinates moves corners by how far they lie from the pixel: by its sum and
// its moments.
struct FaceGradient {
    // Of the corners on the plane, by the distance to the nearest edge.
    a: vec2<f32>,
    b: vec2<f32>,
    c: vec2<f32>,
    // Of their 1/z.
    inv_z: vec3<f32>,
    colour: vec3<f32>,
    // Of the barycentric coordinates, and the same times the pixel's place in the box, in pixels.
    bary: vec3<f32>,
    bary_x: vec3<f32>,
    bary_y: vec3<f32>,
}

// A drawn face, with its edges where its box begins.
struct DrawnFace {
    face: SoftFace,
    edges: Edges,
    colour: vec3<f32>,
    first: vec2<i32>,
    size: vec2<i32>,
}

fn drawn_face(f: u32) -> DrawnFace {
    let box = boxes[f];
    let first = vec2<i32>(box & vec2<u32>(0xffffu));
    let last = vec2<i32>(box >> vec2<u32>(16u));
    let face = unpack_face(records[4u * f], records[4u * f + 1u], records[4u * f + 2u], records[4u * f + 3u]);
    let colour = vec3<f32>(face_colours[3u * f], face_colours[3u * f + 1u], face_colours[3u * f + 2u]);
    return DrawnFace(face, edges_from(face, pixel_centre(first.x, first.y)), colour, first, last - first + 1);
}

// Adds what the pixel `at` of the box tells of the face.
fn add_pixel(sum: ptr<function, FaceGradient>, drawn: DrawnFace, at: vec2<i32>) {
    let edges = drawn.edges;
    let pixel = u32(drawn.first.y + at.y) * params.width + u32(drawn.first.x + at.x);
    let place = vec2<f32>(at);
    let d = place * (params.scale / params.norm_px);
    let line = edges.line + edges.dir_x * d.y - edges.dir_y * d.x;
    let along = edges.along + edges.dir_x * d.x + edges.dir_y * d.y;
    let r = fragment_at(edges, drawn.face.inv_z, line, along);

    let seen = pixels[pixel];
    let g = seen.xyz;
    let e = exp(-abs(r.x));
    let inv = 1.0 / (1.0 + e);
    // No share is above one; but a face at the very cut may count here and not in the forward pass, by rounding,
    // and would then have no bound where only the far background competes.
    let share = min(exp(min(nearness(r.z) - seen.w + min(r.x, 0.0), 1.0)) * inv, 1.0);
    let weight = select(0.0, share, r.counts);
    let gs = weight * (dot(g, drawn.colour) - pixels_rest[pixel].x);
    var gx = gs * select(1.0, e, r.x > 0.0) * inv;
    if COVERAGE {
        gx += select(0.0, pixels_rest[pixel].y * select(e, 1.0, r.x > 0.0) * inv, r.counts);
    }
    (*sum).colour += weight * g;

    // The nearest edge: its direction, and the foot's place along it.
    let bc = r.d2.x <= r.d2.y && r.d2.x <= r.d2.z;
    let ca = !bc && r.d2.y <= r.d2.z;
    let dir_x = select(select(edges.dir_x.z, edges.dir_x.y, ca), edges.dir_x.x, bc);
    let dir_y = select(select(edges.dir_y.z, edges.dir_y.y, ca), edges.dir_y.x, bc);
    let inv_length = select(select(edges.inv_length.z, edges.inv_length.y, ca), edges.inv_length.x, bc);
    let away = select(select(line.z, line.y, ca), line.x, bc);
    let beyond = select(select(r.over.z, r.over.y, ca), r.over.x, bc);
    let t = (select(select(along.z, along.y, ca), along.x, bc) - beyond) * inv_length;
    let rest = 1.0 - t;
    let g_d = -2.0 * params.scale * select(-gx, gx, r.x > 0.0);
    let g_delta = g_d * vec2<f32>(dir_x * beyond - dir_y * away, dir_y * beyond + dir_x * away);
    (*sum).a += select(select(rest, t, ca), 0.0, bc) * g_delta;
    (*sum).b += select(select(t, 0.0, ca), rest, bc) * g_delta;
    (*sum).c += select(select(0.0, rest, ca), t, bc) * g_delta;

    let inv_total = 1.0 / r.total;
    let s = r.depth * inv_total;
    let g_s = select(0.0, r.z * r.z * gs * inv_total * params.depth_scale, r.counts);
    (*sum).inv_z += g_s * r.clamped;
    let passes = (r.w > vec3<f32>(0.0)) & (r.w < vec3<f32>(1.0));
    let gw = select(vec3<f32>(0.0), g_s * (drawn.face.inv_z - s), passes);
    let gd = gw - dot(gw, r.w);
    (*sum).bary += gd;
    (*sum).bary_x += gd * place.x;
    (*sum).bary_y += gd * place.y;
}

// What a face is told, linear in its sums: a corner's place on the plane and its 1/z, three corners after each other; the colour.
const TOLD: u32 = 12u;

fn told(drawn: DrawnFace, sum: FaceGradient) -> array<f32, TOLD> {
    let face = drawn.face;
    let origin = pixel_centre(drawn.first.x, drawn.first.y);
    let qa = face.a - origin;
    let qb = face.b - origin;
    let qc = face.c - origin;
    let g = sum.bary * face.inv_area;
    let gx = sum.bary_x * (face.inv_area / params.norm_px);
    let gy = sum.bary_y * (face.inv_area / params.norm_px);
    // w_k = q_i x q_j / area, with q_i - pixel for q_i.
    let a = sum.a + vec2<f32>(g.z * qb.y - gy.z - g.y * qc.y + gy.y, g.y * qc.x - gx.y - g.z * qb.x + gx.z);
    let b = sum.b + vec2<f32>(g.x * qc.y - gy.x - g.z * qa.y + gy.z, g.z * qa.x - gx.z - g.x * qc.x + gx.x);
    let c = sum.c + vec2<f32>(g.y * qa.y - gy.y - g.x * qb.y + gy.x, g.x * qb.x - gx.x - g.y * qa.x + gx.y);
    return array<f32, TOLD>(
        a.x, a.y, sum.inv_z.x, b.x, b.y, sum.inv_z.y, c.x, c.y, sum.inv_z.z, sum.colour.x, sum.colour.y, sum.colour.z,
    );
}

// From the normalised plane and 1/z back to camera space, for one corner.
fn write_corner(i: u32, p: vec2<f32>, inv_z: f32, gp: vec2<f32>, g_inv_z: f32) {
    let focal = vec2<f32>(params.fx, params.fy);
    let size = vec2<f32>(f32(params.width), f32(params.height));
    let shift = (vec2<f32>(params.cx, params.cy) - 0.5 * size) / params.norm_px;
    let xy = gp * focal * inv_z / params.norm_px;
    grad_corners[i] = xy.x;
    grad_corners[i + 1u] = xy.y;
    grad_corners[i + 2u] = -dot(gp, p - shift) * inv_z - g_inv_z * inv_z * inv_z;
}
