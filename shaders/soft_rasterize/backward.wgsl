// Backward pass 2, one face an invocation: the gradient of its corners [F, 3, 3] and of its colour, over its box.
//
// With the score s = ln D + (z^ - 1)/gamma, weight w = exp(s)/W, D = sigmoid(x), x = +-d^2/sigma:
//   dL/ds = w (g.C - g.rgb),  dL/dx = dL/ds (1 - D) + T dL/dalpha D,  dL/dC = w g.
// d^2 = |delta|^2 with the nearest boundary point sum foot_k p_k:  dd^2/dp_k = -2 foot_k delta (the foot is optimal).
// z = 1/S with S = sum c_k (1/z_k) / sum c_k, c = clamp(w): passes where 0 < w < 1; w_k = q_i x q_j / area as in
// hard_rasterize/backward.
#import shared/linear_index
#import shared/soft_face

@group(0) @binding(0) var<uniform> params: SoftParams;
@group(0) @binding(1) var<storage, read> records: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> boxes: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read> face_colours: array<f32>;
@group(0) @binding(4) var<storage, read> pixels: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> gates: array<f32>;
@group(0) @binding(6) var<storage, read_write> grad_corners: array<f32>;
@group(0) @binding(7) var<storage, read_write> grad_face_colours: array<f32>;

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

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let f = linear_index(id, groups, 64u);
    if f >= params.n_faces {
        return;
    }
    let face = unpack_face(records[4u * f], records[4u * f + 1u], records[4u * f + 2u], records[4u * f + 3u]);
    let own = vec3<f32>(face_colours[3u * f], face_colours[3u * f + 1u], face_colours[3u * f + 2u]);
    let first = vec2<i32>(boxes[f] & vec2<u32>(0xffffu));
    let last = vec2<i32>(boxes[f] >> vec2<u32>(16u));
    let nearest = nearness(face.z_min);
    let depth_scale = -1.0 / ((params.far - params.near) * params.gamma);
    var ga = vec2<f32>(0.0);
    var gb = vec2<f32>(0.0);
    var gc = vec2<f32>(0.0);
    var g_inv_z = vec3<f32>(0.0);
    var g_colour = vec3<f32>(0.0);

    var x = first.x;
    // A face that is not drawn has an empty box.
    var y = select(first.y, last.y + 1, first.x > last.x);
    loop {
        // The search is cheap and ends for all lanes of a subgroup before the costly part begins.
        var at = vec2<i32>(-1);
        while y <= last.y && at.x < 0 {
            if nearest >= gates[u32(y) * params.width + u32(x)] {
                at = vec2<i32>(x, y);
            }
            x++;
            if x > last.x {
                x = first.x;
                y++;
            }
        }
        if at.x < 0 {
            break;
        }
        let r = fragment_at(face, pixel_centre(at.x, at.y));
        if r.counts {
            let pixel = u32(at.y) * params.width + u32(at.x);
            let g = pixels[2u * pixel].xyz;
            let state = pixels[2u * pixel + 1u];
            let e = exp(-abs(r.x));
            let inv = 1.0 / (1.0 + e);
            // No share is above one; but a face at the very cut may count here and not in the forward pass, by rounding,
            // and would then have no bound where only the far background competes.
            let weight = min(exp(min(nearness(r.z) - state.x + min(r.x, 0.0), 1.0)) * inv, 1.0);
            let gs = weight * (dot(g, own) - state.z);
            let gx = (gs * select(1.0, e, r.x > 0.0) + state.y * select(e, 1.0, r.x > 0.0)) * inv;
            g_colour += weight * g;

            let g_delta = -2.0 * sign(r.x) * gx / params.sigma * r.delta;
            ga += r.foot.x * g_delta;
            gb += r.foot.y * g_delta;
            gc += r.foot.z * g_delta;

            let s = 1.0 / r.z;
            let g_s = -r.z * r.z * gs * depth_scale / r.total;
            g_inv_z += g_s * r.clamped;
            let passes = (r.w > vec3<f32>(0.0)) & (r.w < vec3<f32>(1.0));
            let gw = select(vec3<f32>(0.0), g_s * (face.inv_z - s), passes);
            let gd = (gw - dot(gw, r.w)) * face.inv_area;
            let p = pixel_centre(at.x, at.y);
            let qa = face.a - p;
            let qb = face.b - p;
            let qc = face.c - p;
            ga += vec2<f32>(gd.z * qb.y - gd.y * qc.y, gd.y * qc.x - gd.z * qb.x);
            gb += vec2<f32>(gd.x * qc.y - gd.z * qa.y, gd.z * qa.x - gd.x * qc.x);
            gc += vec2<f32>(gd.y * qa.y - gd.x * qb.y, gd.x * qb.x - gd.y * qa.x);
        }
    }
    write_corner(9u * f, face.a, face.inv_z.x, ga, g_inv_z.x);
    write_corner(9u * f + 3u, face.b, face.inv_z.y, gb, g_inv_z.y);
    write_corner(9u * f + 6u, face.c, face.inv_z.z, gc, g_inv_z.z);
    grad_face_colours[3u * f] += g_colour.x;
    grad_face_colours[3u * f + 1u] += g_colour.y;
    grad_face_colours[3u * f + 2u] += g_colour.z;
}
