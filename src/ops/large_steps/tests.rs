use super::{LargeSteps, ROUNDS, Spectrum, TOLERANCE, cpu};
use crate::ops::Topology;
use crate::ops::testing::{assert_close, gpu};

const LAMBDA: f64 = 19.0;

/// A sheet of 6×6 vertices.
fn sheet() -> Topology {
    let at = |x: u32, y: u32| 6 * y + x;
    let mut faces = Vec::new();
    for (x, y) in (0..25).map(|k| (k % 5, k / 5)) {
        faces.push([at(x, y), at(x + 1, y), at(x, y + 1)]);
        faces.push([at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)]);
    }
    Topology::new(36, &faces)
}

fn field(n: usize) -> Vec<f64> {
    (0..n).map(|k| ((k * 7919) % 13) as f64 - 6.0).collect()
}

/// `(I + λL) x`
fn system(mesh: &Topology, x: &[f64]) -> Vec<f64> {
    let mut b = x.to_vec();
    for i in 0..mesh.neighbours.len() {
        for &j in mesh.neighbours.row(i) {
            (0..3).for_each(|k| b[3 * i + k] += LAMBDA * (x[3 * i + k] - x[3 * j as usize + k]));
        }
    }
    b
}

#[test]
fn many_rounds_solve_the_equations() {
    let mesh = sheet();
    let (starts, items) = (&mesh.neighbours.starts, &mesh.neighbours.items);
    let b = field(108);
    let x = cpu::solve(starts, items, &b, LAMBDA, 300);
    assert_close("b", &system(&mesh, &x), &b, 1e-9);
}

#[test]
fn the_usual_rounds_come_near() {
    let mesh = sheet();
    let (starts, items) = (&mesh.neighbours.starts, &mesh.neighbours.items);
    let exact = field(108);
    let x = cpu::solve(starts, items, &system(&mesh, &exact), LAMBDA, ROUNDS);
    let error = |a: &[f64]| a.iter().zip(&exact).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt();
    assert!(error(&x) < 0.05 * error(&vec![0.0; 108]), "{} of {}", error(&x), error(&vec![0.0; 108]));
}

#[test]
fn the_solver_is_symmetric_and_never_turns_a_direction_round() {
    let mesh = sheet();
    let (starts, items) = (&mesh.neighbours.starts, &mesh.neighbours.items);
    for rounds in [2, 7, ROUNDS] {
        let columns: Vec<Vec<f64>> = (0..36)
            .map(|i| {
                let impulse: Vec<f64> = (0..108).map(|k| (k == 3 * i) as u8 as f64).collect();
                cpu::solve(starts, items, &impulse, LAMBDA, rounds)
            })
            .collect();
        for i in 0..36 {
            for j in 0..i {
                assert!((columns[i][3 * j] - columns[j][3 * i]).abs() < 1e-12, "{rounds} rounds, {i} {j}");
            }
        }
        let alternating: Vec<f64> = (0..108).map(|k| if (k / 3 + k / 18) % 2 == 0 { 1.0 } else { -1.0 }).collect();
        let moved = cpu::solve(starts, items, &alternating, LAMBDA, rounds);
        assert!(moved.iter().zip(&alternating).map(|(a, b)| a * b).sum::<f64>() > 0.0, "{rounds} rounds");
    }
}

/// By inverse and direct power iteration in another way than the op's own: dense, on the scaled matrix.
#[test]
fn the_spectrum_encloses_the_eigenvalues() {
    let mesh = sheet();
    let (starts, items) = (&mesh.neighbours.starts, &mesh.neighbours.items);
    let degree = |i: usize| 1.0 + LAMBDA * mesh.neighbours.row(i).len() as f64;
    let mut scaled = nalgebra::DMatrix::<f64>::identity(36, 36);
    for i in 0..36 {
        for &j in mesh.neighbours.row(i) {
            scaled[(i, j as usize)] = -LAMBDA / (degree(i) * degree(j as usize)).sqrt();
        }
    }
    let eigenvalues = scaled.symmetric_eigenvalues();
    let Spectrum { low, high } = Spectrum::new(starts, items, LAMBDA);
    assert!(high >= eigenvalues.max() && high < 1.1 * eigenvalues.max(), "{high} over {}", eigenvalues.max());
    assert!(low >= eigenvalues.min() && low < 1.2 * eigenvalues.min(), "{low} by {}", eigenvalues.min());
}

#[test]
fn less_coupling_takes_fewer_rounds() {
    let mesh = sheet();
    let (starts, items) = (&mesh.neighbours.starts, &mesh.neighbours.items);
    let rounds = |lambda| Spectrum::new(starts, items, lambda).rounds();
    assert_eq!(rounds(1e-3), 2);
    let (few, many) = (rounds(1.0), rounds(LAMBDA));
    assert!(2 < few && few < many && many < ROUNDS, "{few} and {many}");
    // And they come as near as they say.
    let (b, norm) = (field(108), |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>().sqrt());
    let x = cpu::solve(starts, items, &b, LAMBDA, many);
    let residual: Vec<f64> = system(&mesh, &x).iter().zip(&b).map(|(a, b)| a - b).collect();
    assert!(norm(&residual) < TOLERANCE * norm(&b), "{} of {}", norm(&residual), norm(&b));
}

#[test]
fn gpu_matches_the_twin() {
    let Some(gpu) = gpu("large_steps::gpu_matches_the_twin") else { return };
    let mesh = sheet();
    let (starts, items) = (&mesh.neighbours.starts, &mesh.neighbours.items);
    let b: Vec<f32> = field(108).iter().map(|&x| x as f32).collect();
    let rounds = Spectrum::new(starts, items, LAMBDA).rounds();
    let want = cpu::solve(starts, items, &b, LAMBDA, rounds);
    let (right_side, x) = (gpu.upload("right_side", &b), gpu.upload("x", &[7.0f32; 108]));
    let solver = LargeSteps::new(&gpu, starts, items, LAMBDA);
    let mut recorder = gpu.recorder("large_steps/test");
    solver.solve(&mut recorder, &right_side, &x);
    recorder.submit().unwrap();
    assert_close("x", &gpu.read(&x).unwrap(), &want, 1e-4);
}
