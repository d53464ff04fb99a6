use super::{Diffuse, cpu};
use crate::ops::testing::{assert_close, gpu};

/// A strip of vertices 0 – 1 – … – 5 with one extra edge 0 – 2.
fn strip() -> (Vec<u32>, Vec<u32>) {
    let rows: [&[u32]; 6] = [&[1, 2], &[0, 2], &[0, 1, 3], &[2, 4], &[3, 5], &[4]];
    let mut starts = vec![0];
    for row in rows {
        starts.push(starts.last().unwrap() + row.len() as u32);
    }
    (starts, rows.concat())
}

fn impulse(i: usize) -> Vec<f64> {
    (0..18).map(|k| if k == 3 * i { 1.0 } else { 0.0 }).collect()
}

#[test]
fn a_step_is_symmetric_and_keeps_constants() {
    let (starts, neighbours) = strip();
    for i in 0..6 {
        let from_i = cpu::step(&starts, &neighbours, &impulse(i));
        assert!((from_i.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        for j in 0..6 {
            let from_j = cpu::step(&starts, &neighbours, &impulse(j));
            assert!((from_i[3 * j] - from_j[3 * i]).abs() < 1e-12, "{i} {j}");
        }
    }
    let constant = vec![2.5; 18];
    assert_eq!(cpu::step(&starts, &neighbours, &constant), constant);
}

#[test]
fn a_step_never_turns_a_direction_round() {
    let (starts, neighbours) = strip();
    let alternating: Vec<f64> = (0..18).map(|k| if (k / 3) % 2 == 0 { 1.0 } else { -1.0 }).collect();
    let moved = cpu::step(&starts, &neighbours, &alternating);
    assert!(moved.iter().zip(&alternating).map(|(a, b)| a * b).sum::<f64>() >= 0.0);
}

#[test]
fn gpu_matches_the_twin() {
    let Some(gpu) = gpu("diffuse::gpu_matches_the_twin") else { return };
    let (starts, neighbours) = strip();
    let mut want: Vec<f32> = (0..18).map(|k| ((k * 7919) % 13) as f32 - 6.0).collect();
    let values = gpu.upload("values", &want);
    let diffuse = Diffuse::new(&gpu, &starts, &neighbours);
    let mut recorder = gpu.recorder("diffuse/test");
    diffuse.apply(&mut recorder, &values, 3);
    recorder.submit().unwrap();
    for _ in 0..6 {
        want = cpu::step(&starts, &neighbours, &want);
    }
    assert_close("values", &gpu.read(&values).unwrap(), &want, 1e-6);
}
