// A triangle on the normalised image plane against a pixel centre; see src/ops/soft_rasterize/mod.rs.
// The importing file binds `params: SoftParams`.

// Side of a tile in pixels.
#const TILE: u32 = 4u
const TILE_PIXELS: u32 = TILE * TILE;
// A pixel whose T is below exp(-NEGLIGIBLE) = 6e-6 is opaque, a weight below it is none.
const NEGLIGIBLE: f32 = 12.0;

struct SoftParams {
    n_faces: u32,
    width: u32,
    height: u32,
    tiles_x: u32,
    n_tiles: u32,
    capacity: u32,
    fx: f32,
    fy: f32,
    cx: f32,
    cy: f32,
    norm_px: f32,
    sigma: f32,
    gamma: f32,
    eps: f32,
    near: f32,
    far: f32,
    cut: f32,
    red: f32,
    green: f32,
    blue: f32,
}

// Four vec4 a face: corners (normalised), 1/z of the corners, 1/length^2 of the edges ab bc ca, 1/(twice the signed
// area), the smallest z of the corners.
struct SoftFace {
    a: vec2<f32>,
    b: vec2<f32>,
    c: vec2<f32>,
    inv_area: f32,
    z_min: f32,
    inv_z: vec3<f32>,
    inv_length2: vec3<f32>,
}

struct Fragment {
    counts: bool,
    // +-d^2/sigma and the vector from the nearest boundary point, whose barycentric coordinates are `foot`.
    x: f32,
    delta: vec2<f32>,
    foot: vec3<f32>,
    // Barycentric coordinates, the same clamped, their sum, and the depth.
    w: vec3<f32>,
    clamped: vec3<f32>,
    total: f32,
    z: f32,
}

fn unpack_face(r0: vec4<f32>, r1: vec4<f32>, r2: vec4<f32>, r3: vec4<f32>) -> SoftFace {
    return SoftFace(r0.xy, r0.zw, r1.xy, r1.z, r1.w, r2.xyz, r3.xyz);
}

fn pixel_centre(x: i32, y: i32) -> vec2<f32> {
    let size = vec2<f32>(f32(params.width), f32(params.height));
    return (vec2<f32>(f32(x), f32(y)) + 0.5 - 0.5 * size) / params.norm_px;
}

fn cross2(a: vec2<f32>, b: vec2<f32>) -> f32 {
    return a.x * b.y - a.y * b.x;
}

fn fragment_at(f: SoftFace, p: vec2<f32>) -> Fragment {
    let qa = f.a - p;
    let qb = f.b - p;
    let qc = f.c - p;
    var r: Fragment;
    r.w = vec3<f32>(cross2(qb, qc), cross2(qc, qa), cross2(qa, qb)) * f.inv_area;
    let ab = f.b - f.a;
    let bc = f.c - f.b;
    let ca = f.a - f.c;
    let t = clamp(-vec3<f32>(dot(qa, ab), dot(qb, bc), dot(qc, ca)) * f.inv_length2, vec3<f32>(0.0), vec3<f32>(1.0));
    let to_ab = -(qa + t.x * ab);
    let to_bc = -(qb + t.y * bc);
    let to_ca = -(qc + t.z * ca);
    let d_ab = dot(to_ab, to_ab);
    let d_bc = dot(to_bc, to_bc);
    let d_ca = dot(to_ca, to_ca);
    let bc_first = d_bc < d_ab;
    var d2 = min(d_ab, d_bc);
    r.delta = select(to_ab, to_bc, bc_first);
    r.foot = select(vec3<f32>(1.0 - t.x, t.x, 0.0), vec3<f32>(0.0, 1.0 - t.y, t.y), bc_first);
    let ca_first = d_ca < d2;
    d2 = min(d2, d_ca);
    r.delta = select(r.delta, to_ca, ca_first);
    r.foot = select(r.foot, vec3<f32>(t.z, 0.0, 1.0 - t.z), ca_first);
    let inside = all(r.w > vec3<f32>(0.0));
    r.x = select(-d2, d2, inside) / params.sigma;
    r.clamped = clamp(r.w, vec3<f32>(0.0), vec3<f32>(1.0));
    r.total = r.clamped.x + r.clamped.y + r.clamped.z;
    r.z = r.total / dot(r.clamped, f.inv_z);
    r.counts = r.x > -params.cut && r.z > params.near && r.z < params.far;
    return r;
}

// ln(1 + exp(-|x|)): -ln D = this + max(-x, 0) and -ln(1 - D) = this + max(x, 0) for D = sigmoid(x).
fn soft_rest(x: f32) -> f32 {
    let e = exp(-abs(x));
    return select(log(1.0 + e), e - 0.5 * e * e, e < 1e-3);
}

// (z^ - 1)/gamma: all scores count from the near plane, where small differences keep their digits.
fn nearness(z: f32) -> f32 {
    return (params.near - z) / ((params.far - params.near) * params.gamma);
}
