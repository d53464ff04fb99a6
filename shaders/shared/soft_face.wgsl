// A triangle on the normalised image plane against a pixel centre; see src/ops/soft_rasterize/mod.rs.
// The importing file binds `params: SoftParams`.

// Side of a tile in pixels.
#const TILE: u32 = 4u
const TILE_PIXELS: u32 = TILE * TILE;
// A share below exp(-NEGLIGIBLE) = 6e-6 is none.
const NEGLIGIBLE: f32 = 12.0;

// Tiles and faces stand in the order of how much there is to do for them, most first: by such classes, four an octave. Where
// neighbours take equally long, a vector of them ends together.
const SIZES: u32 = 64u;

fn size_class(n: u32) -> u32 {
    let octave = firstLeadingBit(n);
    return SIZES - 1u - min(4u * octave + (((n << 2u) >> octave) & 3u), SIZES - 1u);
}

// Invocations of a workgroup that take an item each.
const WORKGROUP: u32 = 64u;

// Which item of a list in that order an invocation takes. A software driver gives each of its threads one stretch of the
// workgroups; groups next to each other lie DEALT apart in the list, so that each stretch has all sizes.
const DEALT: u32 = 8u;

fn dealt_item(group: vec3<u32>, groups: vec3<u32>, lane: u32) -> u32 {
    let rounds = groups.x * groups.y / DEALT;
    let g = group.x + group.y * groups.x;
    return ((g % rounds) * DEALT + g / rounds) * WORKGROUP + lane;
}

// Pixels of a box `first | last << 16` along both axes.
fn box_pixels(box: vec2<u32>) -> u32 {
    let sides = (box >> vec2<u32>(16u)) + 1u - (box & vec2<u32>(0xffffu));
    return sides.x * sides.y;
}

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
    // 1/sqrt(sigma), and 1/((far - near) gamma).
    scale: f32,
    depth_scale: f32,
    red: f32,
    green: f32,
    blue: f32,
}

// Four vec4 a face: corners (normalised), 1/z of the corners, 1/length^2 of the edges bc ca ab, 1/(twice the signed
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

// The edges bc, ca, ab (each opposite the corner of its place) against a point, in units of sqrt(sigma). Where the point
// moves by delta, `line` changes by cross(dir, delta) and `along` by dot(dir, delta): a pixel costs a few additions.
struct Edges {
    dir_x: vec3<f32>,
    dir_y: vec3<f32>,
    length: vec3<f32>,
    inv_length: vec3<f32>,
    // Barycentric coordinates are line * to_bary.
    to_bary: vec3<f32>,
    // Signed distance from each edge's line, and the place along it.
    line: vec3<f32>,
    along: vec3<f32>,
}

// A face at a pixel.
struct Fragment {
    counts: bool,
    // +-d^2/sigma, + inside.
    x: f32,
    // Squared distance to each edge, and how far the point lies beyond the edge's ends.
    d2: vec3<f32>,
    over: vec3<f32>,
    // Barycentric coordinates, the same clamped, their sum, and the depth.
    w: vec3<f32>,
    clamped: vec3<f32>,
    total: f32,
    z: f32,
    // total / z
    depth: f32,
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

fn edges_from(f: SoftFace, p: vec2<f32>) -> Edges {
    let scale = params.scale;
    let x = vec3<f32>(f.c.x - f.b.x, f.a.x - f.c.x, f.b.x - f.a.x);
    let y = vec3<f32>(f.c.y - f.b.y, f.a.y - f.c.y, f.b.y - f.a.y);
    let inv_length = sqrt(f.inv_length2);
    let length = (x * x + y * y) * inv_length;
    let qx = (p.x - vec3<f32>(f.b.x, f.c.x, f.a.x)) * scale;
    let qy = (p.y - vec3<f32>(f.b.y, f.c.y, f.a.y)) * scale;
    var e: Edges;
    e.dir_x = x * inv_length;
    e.dir_y = y * inv_length;
    e.length = length * scale;
    e.inv_length = inv_length / scale;
    e.to_bary = length * f.inv_area / scale;
    e.line = e.dir_x * qy - e.dir_y * qx;
    e.along = e.dir_x * qx + e.dir_y * qy;
    return e;
}

fn fragment_at(e: Edges, inv_z: vec3<f32>, line: vec3<f32>, along: vec3<f32>) -> Fragment {
    var r: Fragment;
    r.over = along - clamp(along, vec3<f32>(0.0), e.length);
    r.d2 = line * line + r.over * r.over;
    let nearest = min(r.d2.x, min(r.d2.y, r.d2.z));
    r.w = line * e.to_bary;
    r.x = select(-nearest, nearest, all(r.w > vec3<f32>(0.0)));
    r.clamped = clamp(r.w, vec3<f32>(0.0), vec3<f32>(1.0));
    r.total = r.clamped.x + r.clamped.y + r.clamped.z;
    r.depth = dot(r.clamped, inv_z);
    r.z = r.total / r.depth;
    r.counts = r.x > -params.cut && r.z > params.near && r.z < params.far;
    return r;
}

// (z^ - 1)/gamma: all scores count from the near plane, where small differences keep their digits.
fn nearness(z: f32) -> f32 {
    return (params.near - z) * params.depth_scale;
}
