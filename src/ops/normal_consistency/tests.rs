use super::{NormalConsistency, cpu};
use crate::body::Body;
use crate::gpu::Gpu;
use crate::ops::face_normals::{self, FaceNormals};
use crate::ops::linear::Vector;
use crate::ops::testing::{GRADIENT, VALUE, assert_close, assert_gradient, f32s, golden, gpu, points, random};
use crate::ops::{LossSlot, Topology};

/// Two faces over a common edge, bent by a right angle, and a third one behind.
const FACES: [[u32; 3]; 3] = [[0, 1, 2], [1, 0, 3], [3, 0, 4]];
const VERTICES: [f64; 15] = [0.0, 0.0, 0.0, 1.0, 0.1, 0.0, 0.2, 1.0, 0.1, 0.3, -0.1, 1.0, -1.0, 0.2, 0.8];

fn loss(pairs: &[[u32; 2]], faces: &[[u32; 3]], vertices: &[Vector<f64>]) -> f64 {
    cpu::forward(pairs, &face_normals::cpu::forward(faces, vertices))
}

fn gradient(pairs: &[[u32; 2]], faces: &[[u32; 3]], vertices: &[Vector<f64>], weight: f64) -> Vec<Vector<f64>> {
    let normals = face_normals::cpu::forward(faces, vertices);
    let (mut grad_normals, mut grads) = (vec![[0.0; 3]; faces.len()], vec![[0.0; 3]; vertices.len()]);
    cpu::backward(pairs, &normals, weight, &mut grad_normals);
    face_normals::cpu::backward(faces, vertices, &grad_normals, &mut grads);
    grads
}

/// Loss and gradient by the vertices on the device; the slot starts at 1.
fn on_gpu(gpu: &Gpu, faces: &[[u32; 3]], vertices: &[f64], weight: f32) -> (f64, Vec<f32>) {
    let topology = Topology::new(vertices.len() / 3, faces);
    let (op, face_normals) = (NormalConsistency::new(gpu, &topology), FaceNormals::new(gpu, faces, &topology));
    let (normals, grad_normals) = (face_normals.normals(gpu, "normals"), face_normals.normals(gpu, "grad_normals"));
    let (losses, grads) = (gpu.upload("losses", &[1.0f32]), gpu.zeros("grad_vertices", vertices.len()));
    let vertices = gpu.upload("vertices", &f32s(vertices));
    let mut recorder = gpu.recorder("normal_consistency/test");
    face_normals.forward(&mut recorder, &vertices, &normals);
    op.forward(&mut recorder, &normals, LossSlot::new(&losses, 0));
    op.backward(&mut recorder, &normals, weight, &grad_normals);
    face_normals.backward(&mut recorder, &vertices, &grad_normals, &grads);
    recorder.submit().unwrap();
    (gpu.read(&losses).unwrap()[0] as f64 - 1.0, gpu.read(&grads).unwrap())
}

struct Golden {
    faces: Vec<[u32; 3]>,
    pairs: Vec<[u32; 2]>,
    vertices: Vec<f64>,
    loss: f64,
    grad: Vec<f64>,
}

fn load() -> Golden {
    let npz = golden("losses.npz");
    let data = |name: &str| npz.get(name).unwrap().data.clone();
    let index = |name: &str| data(name).iter().map(|&i| i as u32).collect::<Vec<_>>();
    Golden {
        faces: points(&index("faces")),
        pairs: points(&index("face_pairs")),
        vertices: data("rest_vertices").iter().zip(data("offsets")).map(|(v, d)| v + d).collect(),
        loss: npz.scalar("normal_consistency").unwrap(),
        grad: data("grad_normal_consistency"),
    }
}

#[test]
fn gradient_over_a_bent_edge() {
    let pairs = Topology::new(5, &FACES).face_pairs;
    assert_eq!(pairs, [[0, 1], [1, 2]]);
    let grads = gradient(&pairs, &FACES, &points(&VERTICES), 1.0);
    assert_gradient("vertices", &VERTICES, grads.as_flattened(), |x| loss(&pairs, &FACES, &points(x)));
}

#[test]
fn a_flat_mesh_costs_nothing_and_a_fold_costs_two() {
    let pairs = [[0, 1]];
    let at = |z: f64, y: f64| [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, y, z]];
    assert!(loss(&pairs, &FACES[..2], &at(0.0, -1.0)).abs() < 1e-15);
    assert!((loss(&pairs, &FACES[..2], &at(0.0, 0.5)) - 2.0).abs() < 1e-15);
    assert!((loss(&pairs, &FACES[..2], &at(1.0, 0.0)) - 1.0).abs() < 1e-15);
}

#[test]
fn a_face_without_area_is_finite_and_feels_nothing() {
    let mut vertices = VERTICES;
    vertices.copy_within(0..3, 9); // face 1 collapses onto its edge, face 2 onto a line
    let pairs = Topology::new(5, &FACES).face_pairs;
    assert_eq!(loss(&pairs, &FACES, &points(&vertices)), 2.0);
    let grads = gradient(&pairs, &FACES, &points(&vertices), 1.0);
    assert_eq!(grads, [[0.0; 3]; 5]);
    let Some(gpu) = gpu("normal_consistency::a_face_without_area_is_finite_and_feels_nothing") else { return };
    assert_eq!(on_gpu(&gpu, &FACES, &vertices, 1.0), (2.0, vec![0.0; 15]));
}

#[test]
fn the_topology_finds_the_golden_pairs() {
    let g = load();
    let mut pairs: Vec<[u32; 2]> = g.pairs.iter().map(|&[f, g]| [f.min(g), f.max(g)]).collect();
    pairs.sort_unstable();
    assert_eq!(Topology::new(g.vertices.len() / 3, &g.faces).face_pairs, pairs);
}

#[test]
fn cpu_matches_golden() {
    let g = load();
    let vertices = points(&g.vertices);
    assert_close("loss", &[loss(&g.pairs, &g.faces, &vertices)], &[g.loss], 1e-12);
    assert_close("grad", gradient(&g.pairs, &g.faces, &vertices, 1.0).as_flattened(), &g.grad, 1e-10);
}

#[test]
fn gpu_matches_golden() {
    let Some(gpu) = gpu("normal_consistency::gpu_matches_golden") else { return };
    let g = load();
    let (loss, grad) = on_gpu(&gpu, &g.faces, &g.vertices, 1.0);
    assert_close("loss", &[loss], &[g.loss], VALUE);
    assert_close("grad", &grad, &g.grad, GRADIENT);
}

#[test]
fn gpu_matches_cpu_on_a_crumpled_body() {
    let Some(gpu) = gpu("normal_consistency::gpu_matches_cpu_on_a_crumpled_body") else { return };
    let body = Body::test_body();
    let template = body.v_template.as_flattened().iter().map(|&x| x as f64);
    let vertices: Vec<f64> = template.zip(random(5, 3 * body.n_vertices())).map(|(v, r)| v + 0.01 * r).collect();
    let pairs = Topology::new(body.n_vertices(), &body.faces).face_pairs;
    let (value, grad) = on_gpu(&gpu, &body.faces, &vertices, 0.3);
    assert_close("loss", &[value], &[loss(&pairs, &body.faces, &points(&vertices))], VALUE);
    assert_close("grad", &grad, gradient(&pairs, &body.faces, &points(&vertices), 0.3).as_flattened(), GRADIENT);
}
