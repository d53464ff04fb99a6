use super::{LargeSteps, ROUNDS, TOLERANCE, cpu, radius, rounds};
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

/// A chain of frames is a graph of degree two: it takes fewer rounds than a mesh, and still ends as near.
#[test]
fn a_chain_ends_early_and_near() {
    let n = 60u32;
    let mut starts = vec![0u32];
    let mut items = Vec::new();
    for i in 0..n {
        items.extend([i.checked_sub(1), Some(i + 1).filter(|&k| k < n)].into_iter().flatten());
        starts.push(items.len() as u32);
    }
    let (lambda, b) = (4.0, field(180));
    let used = rounds(radius(&starts, lambda));
    assert!(used < ROUNDS && used.is_multiple_of(2), "{used} rounds");
    assert!(rounds(radius(&starts, 1e-3)) == 2, "hardly any coupling");
    let (x, exact) = (cpu::solve(&starts, &items, &b, lambda, used), cpu::solve(&starts, &items, &b, lambda, 300));
    let norm = |v: &mut dyn Iterator<Item = f64>| v.map(|d| d * d).sum::<f64>().sqrt();
    let error = norm(&mut x.iter().zip(&exact).map(|(a, b)| a - b));
    assert!(error < 2.0 * TOLERANCE * norm(&mut exact.iter().copied()), "{error} after {used} rounds");
}

#[test]
fn gpu_matches_the_twin() {
    let Some(gpu) = gpu("large_steps::gpu_matches_the_twin") else { return };
    let mesh = sheet();
    let (starts, items) = (&mesh.neighbours.starts, &mesh.neighbours.items);
    let b: Vec<f32> = field(108).iter().map(|&x| x as f32).collect();
    let want = cpu::solve(starts, items, &b, LAMBDA, ROUNDS);
    let (right_side, x) = (gpu.upload("right_side", &b), gpu.upload("x", &[7.0f32; 108]));
    let sum = gpu.zeros::<f32>("sum", 108);
    let solver = LargeSteps::new(&gpu, starts, items, LAMBDA);
    let mut recorder = gpu.recorder("large_steps/test");
    solver.solve(&mut recorder, &right_side, &x);
    solver.add(&mut recorder, &x, &right_side, &sum);
    recorder.submit().unwrap();
    assert_close("x", &gpu.read(&x).unwrap(), &want, 1e-4);
    let total: Vec<f32> = want.iter().zip(&b).map(|(a, b)| a + b).collect();
    assert_close("sum", &gpu.read(&sum).unwrap(), &total, 1e-4);
}
