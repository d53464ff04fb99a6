// Backward pass 2, one drawn face an invocation: the gradient of its corners [F, 3, 3] and of its colour, over its box. Faces with
// boxes of one size stand side by side in `drawn`, so that a vector of them ends together.
#import shared/soft_face
#import shared/soft_gradient

@compute @workgroup_size(WORKGROUP)
fn main(
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let place = dealt_item(group, groups, lane);
    if place >= drawn[0] {
        return;
    }
    let f = drawn[1u + place];
    let face = drawn_face(f);
    var sum: FaceGradient;
    var at = vec2<i32>(0);
    while at.y < face.size.y {
        add_pixel(&sum, face, at);
        at.x++;
        if at.x == face.size.x {
            at = vec2<i32>(0, at.y + 1);
        }
    }
    let g = told(face, sum);
    write_corner(9u * f, face.face.a, face.face.inv_z.x, vec2<f32>(g[0], g[1]), g[2]);
    write_corner(9u * f + 3u, face.face.b, face.face.inv_z.y, vec2<f32>(g[3], g[4]), g[5]);
    write_corner(9u * f + 6u, face.face.c, face.face.inv_z.z, vec2<f32>(g[6], g[7]), g[8]);
#for K in 0..3
    grad_face_colours[3u * f + $Ku] += g[9 + $K];
#end
}
