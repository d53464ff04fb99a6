// Backward pass 2 where many cores run side by side, one drawn face a workgroup: the gradient of its corners [F, 3, 3] and of its
// colour, over its box. The invocations share the pixels of the box; their sums are added in their order.
#import shared/soft_face
#import shared/soft_gradient

#const LANES: u32 = 32u

var<workgroup> sums: array<f32, TOLD * LANES>;
var<workgroup> totals: array<f32, TOLD>;

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
    let face = drawn_face(f);
    let inv_width = 1.0 / f32(face.size.x);
    var sum: FaceGradient;
    for (var k = i32(lane); k < face.size.x * face.size.y; k += i32(LANES)) {
        // The division may be off by one where the box is large.
        var row = i32((f32(k) + 0.5) * inv_width);
        row -= i32(row * face.size.x > k);
        row += i32((row + 1) * face.size.x <= k);
        add_pixel(&sum, face, vec2<i32>(k - row * face.size.x, row));
    }
    let mine = told(face, sum);
#for K in 0..12
    sums[$Ku * LANES + lane] = mine[$K];
#end
    workgroupBarrier();
    for (var k = lane; k < TOLD; k += LANES) {
        var sum = 0.0;
        for (var j = 0u; j < LANES; j++) {
            sum += sums[k * LANES + j];
        }
        totals[k] = sum;
    }
    workgroupBarrier();
    if lane < 3u {
        let p = select(select(face.face.c, face.face.b, lane == 1u), face.face.a, lane == 0u);
        let inv_z = select(select(face.face.inv_z.z, face.face.inv_z.y, lane == 1u), face.face.inv_z.x, lane == 0u);
        let gp = vec2<f32>(totals[3u * lane], totals[3u * lane + 1u]);
        write_corner(9u * f + 3u * lane, p, inv_z, gp, totals[3u * lane + 2u]);
        grad_face_colours[3u * f + lane] += totals[9u + lane];
    }
}
