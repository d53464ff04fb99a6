// Backward pass 2, one drawn face a workgroup: the gradient of its corners [F, 3, 3] and of its colour, over its box. The
// invocations share the pixels of the box; their sums are added in their order.
//
// With the score s = ln D + (z^ - 1)/gamma, weight w = exp(s)/W, D = sigmoid(x), x = +-d^2/sigma:
//   dL/ds = w (g.C - g.rgb),  dL/dx = dL/ds (1 - D) + T dL/dalpha D,  dL/dC = w g.
// d^2 = |delta|^2 with the nearest boundary point sum foot_k p_k:  dd^2/dp_k = -2 foot_k delta (the foot is optimal).
// z = 1/S with S = sum c_k (1/z_k) / sum c_k, c = clamp(w): passes where 0 < w < 1; w_k = q_i x q_j / area as in
// hard_rasterize/backward.
#import shared/soft_face

#const LANES: u32 = 32u
#const COVERAGE: bool = true

// What an invocation sums up: the corners on the plane, their 1/z, the colour.
const SUMS: u32 = 12u;

@group(0) @binding(0) var<uniform> params: SoftParams;
@group(0) @binding(1) var<storage, read> records: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> boxes: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read> face_colours: array<f32>;
@group(0) @binding(4) var<storage, read> pixels: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> pixels_rest: array<vec2<f32>>;
@group(0) @binding(6) var<storage, read> drawn: array<u32>;
@group(0) @binding(7) var<storage, read_write> grad_corners: array<f32>;
@group(0) @binding(8) var<storage, read_write> grad_face_colours: array<f32>;

var<workgroup> sums: array<f32, SUMS * LANES>;
var<workgroup> totals: array<f32, SUMS>;

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

@compute @workgroup_size(LANES)
fn main(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let place = group.x + group.y * groups.x;
    if place >= drawn[0] {
        return;
    }
    let f = drawn[1u + place];
    let first = vec2<i32>(boxes[f] & vec2<u32>(0xffffu));
    let last = vec2<i32>(boxes[f] >> vec2<u32>(16u));
    let face = unpack_face(records[4u * f], records[4u * f + 1u], records[4u * f + 2u], records[4u * f + 3u]);
    let own = vec3<f32>(face_colours[3u * f], face_colours[3u * f + 1u], face_colours[3u * f + 2u]);
    let origin = pixel_centre(first.x, first.y);
    let edges = edges_from(face, origin);
    let scale = inverseSqrt(params.sigma);
    let depth_scale = -1.0 / ((params.far - params.near) * params.gamma);
    let width = last.x - first.x + 1;
    let inv_width = 1.0 / f32(width);
    let n = width * (last.y - first.y + 1);
    var ga = vec2<f32>(0.0);
    var gb = vec2<f32>(0.0);
    var gc = vec2<f32>(0.0);
    var g_inv_z = vec3<f32>(0.0);
    var g_colour = vec3<f32>(0.0);

    for (var k = i32(lane); k < n; k += i32(LANES)) {
        // The division may be off by one where the box is large.
        var row = i32((f32(k) + 0.5) * inv_width);
        row -= i32(row * width > k);
        row += i32((row + 1) * width <= k);
        let at = vec2<i32>(k - row * width, row);
        let pixel = u32(first.y + at.y) * params.width + u32(first.x + at.x);
        let offset = vec2<f32>(at) / params.norm_px;
        let d = scale * offset;
        let line = edges.line + edges.dir_x * d.y - edges.dir_y * d.x;
        let along = edges.along + edges.dir_x * d.x + edges.dir_y * d.y;
        let r = fragment_at(edges, face.inv_z, line, along);

        let seen = pixels[pixel];
        let g = seen.xyz;
        let e = exp(-abs(r.x));
        let inv = 1.0 / (1.0 + e);
        // No share is above one; but a face at the very cut may count here and not in the forward pass, by rounding,
        // and would then have no bound where only the far background competes.
        let share = min(exp(min(nearness(r.z) - seen.w + min(r.x, 0.0), 1.0)) * inv, 1.0);
        let weight = select(0.0, share, r.counts);
        let gs = weight * (dot(g, own) - pixels_rest[pixel].x);
        var gx = gs * select(1.0, e, r.x > 0.0) * inv;
        if COVERAGE {
            gx += select(0.0, pixels_rest[pixel].y * select(e, 1.0, r.x > 0.0) * inv, r.counts);
        }
        g_colour += weight * g;

        // The nearest edge: its direction, and the foot's place along it.
        let bc = r.d2.x <= r.d2.y && r.d2.x <= r.d2.z;
        let ca = !bc && r.d2.y <= r.d2.z;
        let dir = select(
            select(vec2<f32>(edges.dir_x.z, edges.dir_y.z), vec2<f32>(edges.dir_x.y, edges.dir_y.y), ca),
            vec2<f32>(edges.dir_x.x, edges.dir_y.x),
            bc,
        );
        let t3 = (along - r.over) / edges.length;
        let t = select(select(t3.z, t3.y, ca), t3.x, bc);
        let foot = select(select(vec3<f32>(1.0 - t, t, 0.0), vec3<f32>(t, 0.0, 1.0 - t), ca), vec3<f32>(0.0, 1.0 - t, t), bc);
        let away = select(select(line.z, line.y, ca), line.x, bc);
        let beyond = select(select(r.over.z, r.over.y, ca), r.over.x, bc);
        let delta = vec2<f32>(dir.x * beyond - dir.y * away, dir.y * beyond + dir.x * away);
        let g_delta = -2.0 * sign(r.x) * gx * scale * delta;
        ga += foot.x * g_delta;
        gb += foot.y * g_delta;
        gc += foot.z * g_delta;

        let s = 1.0 / r.z;
        let g_s = select(0.0, -r.z * r.z * gs * depth_scale / r.total, r.counts);
        g_inv_z += g_s * r.clamped;
        let passes = (r.w > vec3<f32>(0.0)) & (r.w < vec3<f32>(1.0));
        let gw = select(vec3<f32>(0.0), g_s * (face.inv_z - s), passes);
        let gd = (gw - dot(gw, r.w)) * face.inv_area;
        let p = origin + offset;
        let qa = face.a - p;
        let qb = face.b - p;
        let qc = face.c - p;
        ga += vec2<f32>(gd.z * qb.y - gd.y * qc.y, gd.y * qc.x - gd.z * qb.x);
        gb += vec2<f32>(gd.x * qc.y - gd.z * qa.y, gd.z * qa.x - gd.x * qc.x);
        gc += vec2<f32>(gd.y * qa.y - gd.x * qb.y, gd.x * qb.x - gd.y * qa.x);
    }
    let mine = array<f32, SUMS>(
        ga.x, ga.y, g_inv_z.x, gb.x, gb.y, g_inv_z.y, gc.x, gc.y, g_inv_z.z, g_colour.x, g_colour.y, g_colour.z,
    );
#for K in 0..12
    sums[$Ku * LANES + lane] = mine[$K];
#end
    workgroupBarrier();
    for (var k = lane; k < SUMS; k += LANES) {
        var sum = 0.0;
        for (var j = 0u; j < LANES; j++) {
            sum += sums[k * LANES + j];
        }
        totals[k] = sum;
    }
    workgroupBarrier();
    if lane < 3u {
        let p = select(select(face.c, face.b, lane == 1u), face.a, lane == 0u);
        let inv_z = select(select(face.inv_z.z, face.inv_z.y, lane == 1u), face.inv_z.x, lane == 0u);
        let gp = vec2<f32>(totals[3u * lane], totals[3u * lane + 1u]);
        write_corner(9u * f + 3u * lane, p, inv_z, gp, totals[3u * lane + 2u]);
        grad_face_colours[3u * f + lane] += totals[9u + lane];
    }
}
