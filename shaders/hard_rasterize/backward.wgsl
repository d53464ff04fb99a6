// One face that owns a pixel an invocation: the gradient of its corners [F, 3, 3] from the pixels that it owns.
//
// With q = v.xy - ray v.z, d_a = qb x qc (and cyclic), bary = d / sum(d), z = dot(bary, z_corners):
// dL/dd = (g - dot(g, bary)) / sum(d) where g = grad_bary + grad_zbuf z_corners.
#import shared/linear_index
#import shared/hard_triangle
#import shared/owned_pixels

#const HAS_GRAD_ZBUF: bool = false

@group(0) @binding(0) var<uniform> params: HardParams;
@group(0) @binding(1) var<storage, read> view: array<f32>;
@group(0) @binding(2) var<storage, read> faces: array<u32>;
@group(0) @binding(3) var<storage, read> pix_to_face: array<i32>;
@group(0) @binding(4) var<storage, read> grad_bary: array<f32>;
@group(0) @binding(5) var<storage, read> grad_zbuf: array<f32>;
@group(0) @binding(6) var<storage, read_write> grad_corners: array<f32>;
@group(0) @binding(7) var<storage, read> counts: array<u32>; // of pixels, of faces
@group(0) @binding(8) var<storage, read> owners: array<u32>;

fn write_corner(i: u32, g: vec3<f32>) {
    grad_corners[i] = g.x;
    grad_corners[i + 1u] = g.y;
    grad_corners[i + 2u] = g.z;
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let k = linear_index(id, groups, 64u);
    if k >= counts[1] {
        return;
    }
    let f = owners[k];
    let t = triangle_at(f);
    let box = pixel_box(t);
    var ga = vec3<f32>(0.0);
    var gb = vec3<f32>(0.0);
    var gc = vec3<f32>(0.0);
    var cursor = vec2<i32>(box.x0, box.y0);
    loop {
        let at = next_owned(f, box, &cursor);
        if at.x < 0 {
            break;
        }
        let pixel = u32(at.y) * params.width + u32(at.x);
        let ray = ray_at(at.x, at.y);
        let m = meet(t, ray);
        let bary = m.d / m.total;
        var g = vec3<f32>(grad_bary[3u * pixel], grad_bary[3u * pixel + 1u], grad_bary[3u * pixel + 2u]);
        if HAS_GRAD_ZBUF {
            let gz = grad_zbuf[pixel];
            g += gz * vec3<f32>(t.a.z, t.b.z, t.c.z);
            ga.z += gz * bary.x;
            gb.z += gz * bary.y;
            gc.z += gz * bary.z;
        }
        let gd = (g - dot(g, bary)) / m.total;
        let gqa = vec2<f32>(gd.z * m.qb.y - gd.y * m.qc.y, gd.y * m.qc.x - gd.z * m.qb.x);
        let gqb = vec2<f32>(gd.x * m.qc.y - gd.z * m.qa.y, gd.z * m.qa.x - gd.x * m.qc.x);
        let gqc = vec2<f32>(gd.y * m.qa.y - gd.x * m.qb.y, gd.x * m.qb.x - gd.y * m.qa.x);
        ga += vec3<f32>(gqa, -dot(gqa, ray));
        gb += vec3<f32>(gqb, -dot(gqb, ray));
        gc += vec3<f32>(gqc, -dot(gqc, ray));
    }
    write_corner(9u * f, ga);
    write_corner(9u * f + 3u, gb);
    write_corner(9u * f + 6u, gc);
}
