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

fn depth_of(t: Triangle, m: Meeting) -> f32 {
    return dot(m.d, vec3<f32>(t.a.z, t.b.z, t.c.z)) / m.total;
}

// The pixel after `at` in a box, row by row; below its last row at the end.
fn next_in(box: PixelBox, at: vec2<i32>) -> vec2<i32> {
    return select(at + vec2<i32>(1, 0), vec2<i32>(box.x0, at.y + 1), at.x >= box.x1);
}

// The pixels whose centres the triangle may cover; empty when a corner is not beyond the near plane.
fn pixel_box(t: Triangle) -> PixelBox {
    if !(t.a.z > params.near && t.b.z > params.near && t.c.z > params.near) {
        return PixelBox(0, 0, -1, -1);
    }
    let f = vec2<f32>(params.fx, params.fy);
    let centre = vec2<f32>(params.cx, params.cy);
    let pa = f * t.a.xy / t.a.z + centre;
    let pb = f * t.b.xy / t.b.z + centre;
    let pc = f * t.c.xy / t.c.z + centre;
    let size = vec2<f32>(f32(params.width), f32(params.height));
    // A hair of slack: the projection rounds differently from the test of coverage.
    let low = clamp(ceil(min(pa, min(pb, pc)) - 0.51), vec2<f32>(0.0), size);
    let high = clamp(floor(max(pa, max(pb, pc)) - 0.49), vec2<f32>(-1.0), size - 1.0);
    if !(low.x <= high.x && low.y <= high.y) {
        return PixelBox(0, 0, -1, -1);
    }
    return PixelBox(i32(low.x), i32(low.y), i32(high.x), i32(high.y));
}
