use super::{FaceNormals, cpu};
use crate::body::Body;
use crate::ops::Topology;
use crate::ops::testing::{GRADIENT, VALUE, assert_close, assert_gradient, f32s, gpu, points, random};

#[test]
fn a_counter_clockwise_face_looks_along_its_normal_twice_its_area_long() {
    let normals = cpu::forward(&[[0, 1, 2]], &[[0.0, 0.0, 1.0], [2.0, 0.0, 1.0], [0.0, 3.0, 1.0]]);
    assert_eq!(normals, [[0.0, 0.0, 6.0]]);
}

#[test]
fn gradient_of_vertices_that_faces_share() {
    let faces = [[0, 1, 2], [2, 1, 3], [3, 0, 2]];
    let (x, grad_normals) = (random(1, 12), random(2, 9));
    let mut grads = vec![[0.0; 3]; 4];
    cpu::backward(&faces, &points(&x), &points(&grad_normals), &mut grads);
    assert_gradient("vertices", &x, grads.as_flattened(), |x| {
        let normals = cpu::forward(&faces, &points(x));
        normals.as_flattened().iter().zip(&grad_normals).map(|(n, g)| n * g).sum()
    });
}

#[test]
fn gpu_matches_cpu() {
    let Some(gpu) = gpu("face_normals::gpu_matches_cpu") else { return };
    let body = Body::test_body();
    let (n_vertices, n_faces) = (body.n_vertices(), body.n_faces());
    let (vertices, grad_normals) = (random(3, 3 * n_vertices), random(4, 3 * n_faces));
    let mut grads = vec![[0.5; 3]; n_vertices];
    cpu::backward(&body.faces, &points(&vertices), &points(&grad_normals), &mut grads);

    let op = FaceNormals::new(&gpu, &body.faces, &Topology::new(n_vertices, &body.faces));
    let normals = op.normals(&gpu, "normals");
    let gpu_vertices = gpu.upload("vertices", &f32s(&vertices));
    let gpu_grads = gpu.upload("grad_vertices", &vec![0.5f32; 3 * n_vertices]);
    let mut recorder = gpu.recorder("face_normals/test");
    op.forward(&mut recorder, &gpu_vertices, &normals);
    op.backward(&mut recorder, &gpu_vertices, &gpu.upload("grad_normals", &f32s(&grad_normals)), &gpu_grads);
    recorder.submit().unwrap();
    let want = cpu::forward(&body.faces, &points(&vertices));
    assert_close("normals", &gpu.read(&normals).unwrap(), want.as_flattened(), VALUE);
    assert_close("grad_vertices", &gpu.read(&gpu_grads).unwrap(), grads.as_flattened(), GRADIENT);
}
