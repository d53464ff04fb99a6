// A camera-space triangle against the rays of pixel centres; see src/ops/hard_rasterize/mod.rs. The importing file
// binds `params: HardParams`, `view` [V, 3] and `faces` [F, 3].

#const CULL_BACK: bool = false

struct HardParams {
    n_faces: u32,
    width: u32,
    height: u32,
    near: f32,
    fx: f32,
    fy: f32,
    cx: f32,
    cy: f32,
}

struct Triangle {
    a: vec3<f32>,
    b: vec3<f32>,
    c: vec3<f32>,
}

// Pixels x0..=x1, y0..=y1; empty when x1 < x0.
struct PixelBox {
    x0: i32,
    y0: i32,
    x1: i32,
    y1: i32,
}

// d = (d_a, d_b, d_c): twice the areas opposite the corners, of the triangle sheared so that the ray is the z axis.
// All have one sign where the ray meets the triangle, and bary = d / sum(d) is then perspective-correct.
struct Meeting {
    qa: vec2<f32>,
    qb: vec2<f32>,
    qc: vec2<f32>,
    d: vec3<f32>,
    total: f32,
}

fn vertex_at(i: u32) -> vec3<f32> {
    return vec3<f32>(view[3u * i], view[3u * i + 1u], view[3u * i + 2u]);
}

fn triangle_at(f: u32) -> Triangle {
    return Triangle(vertex_at(faces[3u * f]), vertex_at(faces[3u * f + 1u]), vertex_at(faces[3u * f + 2u]));
}

fn ray_at(x: i32, y: i32) -> vec2<f32> {
    return vec2<f32>((f32(x) + 0.5 - params.cx) / params.fx, (f32(y) + 0.5 - params.cy) / params.fy);
}

fn cross2(a: vec2<f32>, b: vec2<f32>) -> f32 {
    return a.x * b.y - a.y * b.x;
}

fn meet(t: Triangle, ray: vec2<f32>) -> Meeting {
    var m: Meeting;
    m.qa = t.a.xy - ray * t.a.z;
    m.qb = t.b.xy - ray * t.b.z;
    m.qc = t.c.xy - ray * t.c.z;
    m.d = vec3<f32>(cross2(m.qb, m.qc), cross2(m.qc, m.qa), cross2(m.qa, m.qb));
    m.total = m.d.x + m.d.y + m.d.z;
    return m;
}

fn covers(m: Meeting) -> bool {
    let front = all(m.d <= vec3<f32>(0.0)) && m.total < 0.0;
    let back = all(m.d >= vec3<f32>(0.0)) && m.total > 0.0;
    return front || (back && !CULL_BACK);
}

// Whether back faces are left out and the triangle is one, whatever ray meets it: its plane's normal and its rays have one
// sign. Nearly edge-on triangles are left to `covers`, since here rounding could decide. `side` is -1 for corners that were turned over.
fn is_culled(t: Triangle, side: f32) -> bool {
    let normal = cross(t.b - t.a, t.c - t.a);
    return CULL_BACK && side * dot(normal, t.a) > 1e-3 * length(normal) * length(t.a);
}

fn depth_of(t: Triangle, m: Meeting) -> f32 {
    return dot(m.d, vec3<f32>(t.a.z, t.b.z, t.c.z)) / m.total;
}

// The pixel after `at` in a box, row by row; below its last row at the end.
fn next_in(box: PixelBox, at: vec2<i32>) -> vec2<i32> {
    return select(at + vec2<i32>(1, 0), vec2<i32>(box.x0, at.y + 1), at.x >= box.x1);
}

// The triangle in the image, pixels.
fn on_screen(t: Triangle) -> array<vec2<f32>, 3> {
    let f = vec2<f32>(params.fx, params.fy);
    let centre = vec2<f32>(params.cx, params.cy);
    return array<vec2<f32>, 3>(
        f * t.a.xy / t.a.z + centre,
        f * t.b.xy / t.b.z + centre,
        f * t.c.xy / t.c.z + centre,
    );
}

// The pixels whose centres the triangle may cover; empty when a corner is not beyond the near plane.
fn pixel_box(t: Triangle) -> PixelBox {
    if !(t.a.z > params.near && t.b.z > params.near && t.c.z > params.near) {
        return PixelBox(0, 0, -1, -1);
    }
    let p = on_screen(t);
    let size = vec2<f32>(f32(params.width), f32(params.height));
    // A hair of slack: the projection rounds differently from the test of coverage.
    let low = clamp(ceil(min(p[0], min(p[1], p[2])) - 0.51), vec2<f32>(0.0), size);
    let high = clamp(floor(max(p[0], max(p[1], p[2])) - 0.49), vec2<f32>(-1.0), size - 1.0);
    if !(low.x <= high.x && low.y <= high.y) {
        return PixelBox(0, 0, -1, -1);
    }
    return PixelBox(i32(low.x), i32(low.y), i32(high.x), i32(high.y));
}

// A way through the pixels whose centres the triangle may cover: row by row, in each from where the triangle begins to where
// it ends. Half of a triangle's box lies outside of it.
struct Walk {
    box: PixelBox,
    // Of the three edges: the upper end, the height and the run a row.
    x0: vec3<f32>,
    y0: vec3<f32>,
    dy: vec3<f32>,
    slope: vec3<f32>,
    slack: f32,
    // Where it is, and the last pixel of that row.
    at: vec2<i32>,
    end: i32,
}

fn walk_row(before: Walk, y: i32) -> Walk {
    // The edges in a strip around the middle of the row, so that rounding takes no pixel away where an edge is nearly level.
    let middle = vec3<f32>(f32(y) + 0.5);
    let upper = middle - before.slack - before.y0;
    let lower = middle + before.slack - before.y0;
    let xa = before.x0 + before.slope * clamp(upper, vec3<f32>(0.0), before.dy);
    let xb = before.x0 + before.slope * clamp(lower, vec3<f32>(0.0), before.dy);
    let meets = (lower >= vec3<f32>(0.0)) & (upper <= before.dy);
    let left = select(vec3<f32>(3e38), min(xa, xb), meets);
    let right = select(vec3<f32>(-3e38), max(xa, xb), meets);
    let low = ceil(min(left.x, min(left.y, left.z)) - 0.5 - before.slack);
    let high = floor(max(right.x, max(right.y, right.z)) - 0.5 + before.slack);
    var walk = before;
    // Whole numbers once more: corners that are not finite may give anything before.
    let x0 = f32(before.box.x0);
    let x1 = f32(before.box.x1);
    walk.at = vec2<i32>(clamp(i32(clamp(low, x0, x1)), before.box.x0, before.box.x1), y);
    walk.end = min(i32(clamp(high, x0 - 1.0, x1)), before.box.x1);
    return walk;
}

fn walk_of(t: Triangle) -> Walk {
    var walk: Walk;
    walk.box = pixel_box(t);
    let p = on_screen(t);
    let xa = vec3<f32>(p[0].x, p[1].x, p[2].x);
    let ya = vec3<f32>(p[0].y, p[1].y, p[2].y);
    let turned = ya.yzx < ya;
    walk.x0 = select(xa, xa.yzx, turned);
    walk.y0 = select(ya, ya.yzx, turned);
    walk.dy = abs(ya.yzx - ya);
    walk.slope = (select(xa.yzx, xa, turned) - walk.x0) / max(walk.dy, vec3<f32>(1e-9));
    let reach = max(abs(p[0]), max(abs(p[1]), abs(p[2])));
    walk.slack = 0.01 + 1e-6 * max(reach.x, reach.y);
    return walk_row(walk, walk.box.y0);
}

// Whether there is a pixel left; not every pixel on the way is in the triangle's reach, see `walk_meets`.
fn walk_goes_on(walk: Walk) -> bool {
    return walk.at.y <= walk.box.y1;
}

// False in a row that the triangle passes between two centres.
fn walk_meets(walk: Walk) -> bool {
    return walk.at.x <= walk.end;
}

fn walk_next(walk: Walk) -> Walk {
    var next = walk;
    next.at.x++;
    if next.at.x > walk.end {
        next = walk_row(walk, walk.at.y + 1);
    }
    return next;
}
