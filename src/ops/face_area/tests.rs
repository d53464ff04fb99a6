use super::{FaceArea, RATIO_MIN, cpu};
use crate::body::Body;
use crate::gpu::Gpu;
use crate::ops::face_normals::{self, FaceNormals};
use crate::ops::linear::Vector;
use crate::ops::testing::{GRADIENT, VALUE, assert_close, assert_gradient, f32s, golden, gpu, points, random};
use crate::ops::{LossSlot, Topology};

const FACES: [[u32; 3]; 2] = [[0, 1, 2], [2, 1, 3]];
const REST: [f64; 12] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.1, 0.0, 1.0, 0.2, 1.2, 0.9, 0.0];

fn loss(faces: &[[u32; 3]], rest: &[Vector<f64>], vertices: &[Vector<f64>]) -> f64 {
    let normals = |x| face_normals::cpu::forward(faces, x);
    cpu::forward(&normals(vertices), &normals(rest), 0.0)
}

fn gradient(faces: &[[u32; 3]], rest: &[Vector<f64>], vertices: &[Vector<f64>], weight: f64) -> Vec<Vector<f64>> {
    let normals = |x| face_normals::cpu::forward(faces, x);
    let (mut grad_normals, mut grads) = (vec![[0.0; 3]; faces.len()], vec![[0.0; 3]; vertices.len()]);
    cpu::backward(&normals(vertices), &normals(rest), 0.0, weight, &mut grad_normals);
    face_normals::cpu::backward(faces, vertices, &grad_normals, &mut grads);
    grads
}

/// Loss and gradient by the vertices on the device; the slot starts at 1.
fn on_gpu(gpu: &Gpu, faces: &[[u32; 3]], rest: &[f64], vertices: &[f64], weight: f32) -> (f64, Vec<f32>) {
    of_large_faces(gpu, faces, rest, vertices, weight, 0.0)
}

/// The same of faces with a normal longer than `least_rest`.
fn of_large_faces(
    gpu: &Gpu,
    faces: &[[u32; 3]],
    rest: &[f64],
    vertices: &[f64],
    weight: f32,
    least_rest: f32,
) -> (f64, Vec<f32>) {
    let topology = Topology::new(vertices.len() / 3, faces);
    let (op, face_normals) = (FaceArea::new(gpu, faces.len(), least_rest), FaceNormals::new(gpu, faces, &topology));
    let [normals, rest_normals, grad_normals] =
        ["normals", "rest_normals", "grad_normals"].map(|name| face_normals.normals(gpu, name));
    let (losses, grads) = (gpu.upload("losses", &[1.0f32]), gpu.zeros("grad_vertices", vertices.len()));
    let (rest, vertices) = (gpu.upload("rest", &f32s(rest)), gpu.upload("vertices", &f32s(vertices)));
    let mut recorder = gpu.recorder("face_area/test");
    face_normals.forward(&mut recorder, &rest, &rest_normals);
    face_normals.forward(&mut recorder, &vertices, &normals);
    op.forward(&mut recorder, &normals, &rest_normals, LossSlot::new(&losses, 0));
    op.backward(&mut recorder, &normals, &rest_normals, weight, &grad_normals);
    face_normals.backward(&mut recorder, &vertices, &grad_normals, &grads);
    recorder.submit().unwrap();
    (gpu.read(&losses).unwrap()[0] as f64 - 1.0, gpu.read(&grads).unwrap())
}

struct Golden {
    faces: Vec<[u32; 3]>,
    rest: Vec<f64>,
    vertices: Vec<f64>,
    loss: f64,
    /// By the offsets.
    grad: Vec<f64>,
}

fn load() -> Golden {
    let npz = golden("losses.npz");
    let data = |name: &str| npz.get(name).unwrap().data.clone();
    let faces = data("faces").iter().map(|&i| i as u32).collect::<Vec<_>>();
    let rest = data("rest_vertices");
    let vertices = rest.iter().zip(data("offsets")).map(|(v, d)| v + d).collect();
    let (loss, grad) = (npz.scalar("face_area").unwrap(), data("grad_face_area"));
    Golden { faces: points(&faces), rest, vertices, loss, grad }
}

#[test]
fn gradient_of_stretched_and_shrunk_faces() {
    let mut vertices = REST;
    vertices[0] = -0.8; // stretches face 0
    vertices[9] = 0.8; // shrinks face 1
    let grads = gradient(&FACES, &points(&REST), &points(&vertices), 1.0);
    assert_gradient("vertices", &vertices, grads.as_flattened(), |x| loss(&FACES, &points(&REST), &points(x)));
}

#[test]
fn gradient_below_the_least_ratio() {
    let face = [[0, 1, 2]];
    let rest = points(&REST[..9]);
    let mut vertices = REST[..9].to_vec();
    vertices[6..9].copy_from_slice(&[0.5, 0.4 * RATIO_MIN, 0.05]);
    let grads = gradient(&face, &rest, &points(&vertices), 1e-6);
    assert_gradient("vertices", &vertices, grads.as_flattened(), |x| 1e-6 * loss(&face, &rest, &points(x)));
}

#[test]
fn an_undeformed_mesh_costs_two_a_face() {
    assert_eq!(loss(&FACES, &points(&REST), &points(&REST)), 4.0);
    assert_eq!(gradient(&FACES, &points(&REST), &points(&REST), 1.0), [[0.0; 3]; 4]);
}

#[test]
fn faces_without_area_are_finite() {
    let mut collapsed = REST;
    collapsed.copy_within(3..6, 9);
    let (rest, flat) = (points(&REST), points(&collapsed));
    let at_zero = 2.0 / RATIO_MIN;
    assert_close("collapsed", &[loss(&FACES, &rest, &flat)], &[2.0 + at_zero], 1e-6);
    assert_eq!(loss(&FACES, &flat, &rest), 2.0, "a face without area in the undeformed mesh does not count");
    let Some(gpu) = gpu("face_area::faces_without_area_are_finite") else { return };
    let (value, grad) = on_gpu(&gpu, &FACES, &REST, &collapsed, 1.0);
    assert_close("collapsed", &[value], &[2.0 + at_zero], VALUE);
    assert!(grad.iter().all(|g| g.is_finite()));
    assert_eq!(on_gpu(&gpu, &FACES, &collapsed, &REST, 1.0), (2.0, vec![0.0; 12]));
}

#[test]
fn small_faces_do_not_count() {
    // Face 1 is a tenth as large as face 0, and both are stretched.
    let mut rest = REST;
    rest[9..].copy_from_slice(&[0.55, 0.6, 0.15]);
    let stretched = rest.map(|x| 1.1 * x);
    let (of_rest, of_stretched) = (points(&rest), points(&stretched));
    let normals = |x: &[Vector<f64>]| face_normals::cpu::forward(&FACES, x);
    let least = 0.5;
    let alone = loss(&FACES[..1], &of_rest, &of_stretched);
    let large = cpu::forward(&normals(&of_stretched), &normals(&of_rest), least);
    assert_close("loss", &[large], &[alone], 1e-12);
    assert!(loss(&FACES, &of_rest, &of_stretched) > 1.9 * alone);
    let mut grad_normals = [[0.0; 3]; 2];
    cpu::backward(&normals(&of_stretched), &normals(&of_rest), least, 1.0, &mut grad_normals);
    assert!(grad_normals[0] != [0.0; 3] && grad_normals[1] == [0.0; 3], "{grad_normals:?}");
    let Some(gpu) = gpu("face_area::small_faces_do_not_count") else { return };
    let (value, grad) = of_large_faces(&gpu, &FACES, &rest, &stretched, 1.0, least as f32);
    assert_close("loss", &[value], &[alone], VALUE);
    let expected = gradient(&FACES[..1], &of_rest, &of_stretched, 1.0);
    assert_close("grad", &grad, expected.as_flattened(), GRADIENT);
}

#[test]
fn cpu_matches_golden() {
    let g = load();
    let (rest, vertices) = (points(&g.rest), points(&g.vertices));
    assert_close("loss", &[loss(&g.faces, &rest, &vertices)], &[g.loss], 1e-12);
    assert_close("grad", gradient(&g.faces, &rest, &vertices, 1.0).as_flattened(), &g.grad, 1e-10);
}

#[test]
fn gpu_matches_golden() {
    let Some(gpu) = gpu("face_area::gpu_matches_golden") else { return };
    let g = load();
    let (loss, grad) = on_gpu(&gpu, &g.faces, &g.rest, &g.vertices, 1.0);
    assert_close("loss", &[loss], &[g.loss], VALUE);
    assert_close("grad", &grad, &g.grad, GRADIENT);
}

#[test]
fn gpu_matches_cpu_on_a_crumpled_body() {
    let Some(gpu) = gpu("face_area::gpu_matches_cpu_on_a_crumpled_body") else { return };
    let body = Body::test_body();
    let rest: Vec<f64> = body.v_template.as_flattened().iter().map(|&x| x as f64).collect();
    let vertices: Vec<f64> = rest.iter().zip(random(6, rest.len())).map(|(v, r)| v + 0.005 * r).collect();
    let (value, grad) = on_gpu(&gpu, &body.faces, &rest, &vertices, 0.3);
    let (rest, vertices) = (points(&rest), points(&vertices));
    assert_close("loss", &[value], &[loss(&body.faces, &rest, &vertices)], VALUE);
    assert_close("grad", &grad, gradient(&body.faces, &rest, &vertices, 0.3).as_flattened(), GRADIENT);
}
