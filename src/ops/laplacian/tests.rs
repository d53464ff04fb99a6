use super::{Laplacian, cpu};
use crate::body::Body;
use crate::ops::testing::{GRADIENT, VALUE, assert_close, assert_gradient, f32s, gpu, points, random};
use crate::ops::{LossSlot, Topology};

/// A fan with vertices of two and three neighbours, and a vertex without any.
const FACES: [[u32; 3]; 2] = [[0, 1, 2], [2, 1, 3]];

#[test]
fn gradient_at_vertices_of_different_degrees() {
    let rows = Topology::new(5, &FACES).neighbours;
    let x = random(1, 15);
    let mut grads = vec![[0.0; 3]; 5];
    cpu::backward(&rows, &cpu::forward(&rows, &points(&x)).1, 1.0, &mut grads);
    assert_gradient("offsets", &x, grads.as_flattened(), |x| cpu::forward(&rows, &points(x)).0);
    assert_eq!(grads[4], [0.0; 3]);
}

#[test]
fn a_constant_offset_costs_nothing_and_a_spike_costs_its_square() {
    let rows = Topology::new(4, &[[0, 1, 2], [0, 2, 3], [0, 3, 1]]).neighbours;
    assert!(cpu::forward(&rows, &[[0.1, 0.2, 0.3]; 4]).0 < 1e-30);
    let mut spike = [[0.0; 3]; 4];
    spike[0] = [0.0, 3.0, 0.0]; // |3|² at itself, |−1|² at each of its three neighbours
    assert!((cpu::forward(&rows, &spike).0 - 12.0f64).abs() < 1e-12);
}

#[test]
fn gpu_matches_cpu() {
    let Some(gpu) = gpu("laplacian::gpu_matches_cpu") else { return };
    let body = Body::test_body();
    let (n, topology) = (body.n_vertices(), Topology::new(body.n_vertices(), &body.faces));
    let x = random(2, 3 * n);
    let (want, residuals) = cpu::forward(&topology.neighbours, &points(&x));
    let mut grads = vec![[0.5; 3]; n];
    cpu::backward(&topology.neighbours, &residuals, 0.3, &mut grads);

    let op = Laplacian::new(&gpu, &topology);
    let (losses, gpu_grads) = (gpu.upload("losses", &[1.0f32]), gpu.upload("grad_offsets", &vec![0.5f32; 3 * n]));
    let mut recorder = gpu.recorder("laplacian/test");
    op.forward(&mut recorder, &gpu.upload("offsets", &f32s(&x)), LossSlot::new(&losses, 0));
    op.backward(&mut recorder, 0.3, &gpu_grads);
    recorder.submit().unwrap();
    assert_close("loss", &gpu.read(&losses).unwrap(), &[want + 1.0], VALUE);
    assert_close("grad_offsets", &gpu.read(&gpu_grads).unwrap(), grads.as_flattened(), GRADIENT);
}
