use super::{Tridiagonal, cpu};
use crate::ops::testing::{assert_close, gpu};

const LAMBDA: f64 = 4.0;
const PER_FRAME: usize = 3;
const N_FRAMES: usize = 20;

/// Chains of which one is cut twice and one is never tied.
fn linked() -> Vec<bool> {
    let tied = |k: usize| match k % PER_FRAME {
        0 => true,
        1 => ![4, 11].contains(&(k / PER_FRAME)),
        _ => false,
    };
    (0..N_FRAMES * PER_FRAME).map(tied).collect()
}

fn field() -> Vec<f64> {
    (0..3 * PER_FRAME * N_FRAMES).map(|k| ((k * 7919) % 13) as f64 - 6.0).collect()
}

/// `(I + λL) x`
fn system(x: &[f64]) -> Vec<f64> {
    let (linked, stride) = (linked(), 3 * PER_FRAME);
    let mut b = x.to_vec();
    for k in 0..x.len() - stride {
        if linked[k / 3] {
            let pull = LAMBDA * (x[k] - x[k + stride]);
            b[k] += pull;
            b[k + stride] -= pull;
        }
    }
    b
}

#[test]
fn the_equations_are_solved() {
    let x = cpu::solve(&linked(), PER_FRAME, LAMBDA, &field());
    assert_close("b", &system(&x), &field(), 1e-12);
}

#[test]
fn what_is_tied_to_nothing_stays() {
    let (x, b) = (cpu::solve(&linked(), PER_FRAME, LAMBDA, &field()), field());
    for k in (0..b.len()).filter(|k| (k / 3) % PER_FRAME == 2) {
        assert_eq!(x[k], b[k]);
    }
    let single = cpu::solve(&[true], 1, LAMBDA, &[1.0, 2.0, 3.0]);
    assert_eq!(single, [1.0, 2.0, 3.0], "one frame has no next one");
}

/// The gradient of `Σ w · P b` by b is P w.
#[test]
fn the_solution_is_its_own_backward_pass() {
    let upstream: Vec<f64> = field().into_iter().rev().collect();
    let solve = |b: &[f64]| cpu::solve(&linked(), PER_FRAME, LAMBDA, b);
    let loss = |b: &[f64]| solve(b).iter().zip(&upstream).map(|(a, b)| a * b).sum::<f64>();
    crate::ops::testing::assert_gradient("right_side", &field(), &solve(&upstream), loss);
}

#[test]
fn gpu_matches_the_twin() {
    let Some(gpu) = gpu("tridiagonal::gpu_matches_the_twin") else { return };
    let b: Vec<f32> = field().iter().map(|&x| x as f32).collect();
    let (right_side, x) = (gpu.upload("right_side", &b), gpu.upload("x", &vec![7.0f32; b.len()]));
    let solver = Tridiagonal::new(&gpu, &linked(), PER_FRAME, LAMBDA);
    let mut recorder = gpu.recorder("tridiagonal/test");
    solver.solve(&mut recorder, &right_side, &x);
    recorder.submit().unwrap();
    assert_close("x", &gpu.read(&x).unwrap(), &cpu::solve(&linked(), PER_FRAME, LAMBDA, &b), 1e-5);
}
