use super::{Given, Temporal, TemporalConfig, cpu, spacing};
use crate::ops::testing::{assert_close, assert_gradient, gpu};

const CONFIG: TemporalConfig = TemporalConfig { stride: 4, first: 0, scale: 0.3, max_change: 1.0 };

/// Seven frames of four numbers; the second number jumps once.
fn motion() -> Vec<f64> {
    let mut values: Vec<f64> = (0..28).map(|i| ((i * 37) % 11) as f64 * 0.05).collect();
    for frame in 4..7 {
        values[frame * 4 + 1] += 5.0;
    }
    values
}

/// None but of the third number in the fourth frame.
fn expected() -> Vec<f64> {
    let mut expected = vec![0.0; 28];
    expected[14] = 0.4;
    expected
}

/// Seven frames that follow unevenly.
fn uneven() -> Vec<[f64; 2]> {
    spacing(&[0.0, 1.0, 3.0, 4.0, 6.0, 9.0, 10.0])
}

fn even(n: usize) -> Vec<[f64; 2]> {
    spacing(&(0..n).map(|i| i as f64).collect::<Vec<_>>())
}

#[test]
fn the_gradient_is_that_of_the_penalty_also_beside_a_jump() {
    let values = motion();
    for spacing in [even(7), uneven()] {
        let mut grads = vec![0.0; values.len()];
        let given = Given { expected: &expected(), spacing: &spacing };
        cpu::backward(&CONFIG, &values, given, 1.0, &mut grads);
        assert_gradient("values", &values, &grads, |x| cpu::forward(&CONFIG, x, given));
    }
}

#[test]
fn steady_motion_costs_nothing() {
    let steady: Vec<f64> = (0..28).map(|i| (i / 4) as f64 * 0.2).collect();
    let given = Given { expected: &[0.0; 28], spacing: &even(7) };
    assert!(cpu::forward(&CONFIG, &steady, given) < 1e-20);
    let mut shaken = steady.clone();
    shaken[12] += 0.5;
    assert!(cpu::forward(&CONFIG, &shaken, given) > 1.0);
}

#[test]
fn motion_is_as_steady_as_it_is_in_time() {
    let times = [0.0, 1.0, 3.0, 4.0, 6.0, 9.0, 10.0];
    let steady: Vec<f64> = times.iter().flat_map(|t| [0.1 * t; 4]).collect();
    let given = Given { expected: &[0.0; 28], spacing: &uneven() };
    assert!(cpu::forward(&CONFIG, &steady, given) < 1e-20);
    assert!(cpu::forward(&CONFIG, &steady, Given { spacing: &even(7), ..given }) > 1.0);
    // Of a parabola the acceleration is the same wherever it is looked at: its own, in units of the mean time.
    let mean = 10.0 / 6.0;
    let parabola: Vec<f64> = times.iter().flat_map(|t| [0.002 * (t / mean).powi(2); 4]).collect();
    let all = 5.0 * 4.0 * (0.004 / CONFIG.scale).powi(2);
    assert!((cpu::forward(&CONFIG, &parabola, given) / all - 1.0).abs() < 1e-9);
}

#[test]
fn even_frames_have_plain_second_differences_at_any_rate() {
    for step in [1.0, 2.5, 40.0] {
        let factors = spacing(&[0.0, step, 2.0 * step, 3.0 * step]);
        assert_eq!((factors[0], factors[3]), ([0.0; 2], [0.0; 2]));
        assert!(factors[1..3].as_flattened().iter().all(|factor| (factor - 1.0).abs() < 1e-12), "{factors:?}");
    }
    assert_eq!(spacing(&[]), Vec::<[f64; 2]>::new());
    assert_eq!(spacing(&[3.0]), [[0.0; 2]]);
    let twice = spacing(&[0.0, 1.0, 2.0, 2.0, 3.0, 4.0]);
    assert!(twice[1][0] > 0.0 && twice[4][1] > 0.0 && twice[2] == [0.0; 2] && twice[3] == [0.0; 2], "{twice:?}");
}

#[test]
fn an_expected_acceleration_costs_nothing() {
    let mut values: Vec<f64> = (0..28).map(|i| (i / 4) as f64 * 0.2).collect();
    values[18] += 0.2;
    let mut expected = vec![0.0; 28];
    (expected[14], expected[18], expected[22]) = (0.2, -0.4, 0.2);
    let given = Given { expected: &expected, spacing: &even(7) };
    assert!(cpu::forward(&CONFIG, &values, Given { expected: &[0.0; 28], ..given }) > 1.0);
    assert!(cpu::forward(&CONFIG, &values, given) < 1e-20);
}

#[test]
fn two_frames_have_no_acceleration() {
    let mut grads = vec![0.0; 8];
    let given = Given { expected: &[0.0; 8], spacing: &even(2) };
    cpu::backward(&CONFIG, &[0.0, 1.0, 2.0, 3.0, 0.5, 0.5, 0.5, 0.5], given, 1.0, &mut grads);
    assert_eq!(grads, [0.0; 8]);
}

#[test]
fn the_numbers_before_the_first_are_left_alone() {
    let values = motion();
    let config = TemporalConfig { first: 2, ..CONFIG };
    let (mut all, mut some) = (vec![0.0; values.len()], vec![0.0; values.len()]);
    let given = Given { expected: &expected(), spacing: &uneven() };
    cpu::backward(&CONFIG, &values, given, 1.0, &mut all);
    cpu::backward(&config, &values, given, 1.0, &mut some);
    for (all, some) in all.chunks(4).zip(some.chunks(4)) {
        assert_eq!(some[..2], [0.0; 2]);
        assert_eq!(some[2..], all[2..]);
    }
    assert_gradient("values", &values, &some, |x| cpu::forward(&config, x, given));
}

#[test]
fn gpu_matches_the_twin() {
    let Some(gpu) = gpu("temporal::gpu_matches_the_twin") else { return };
    let values: Vec<f32> = motion().iter().map(|&x| x as f32).collect();
    let expected: Vec<f32> = expected().iter().map(|&x| x as f32).collect();
    for config in [CONFIG, TemporalConfig { first: 2, ..CONFIG }] {
        let mut want = vec![1.0f32; values.len()];
        let given = Given { expected: &expected, spacing: &uneven() };
        cpu::backward(&config, &values, given, 0.7, &mut want);
        let (values, grads) = (gpu.upload("values", &values), gpu.upload("grads", &vec![1.0f32; want.len()]));
        let mut recorder = gpu.recorder("temporal/test");
        Temporal::new(&gpu, config, Given { expected: &expected, spacing: &uneven() }).backward(
            &mut recorder,
            &values,
            0.7,
            &grads,
        );
        recorder.submit().unwrap();
        assert_close("grads", &gpu.read(&grads).unwrap(), &want, 1e-5);
    }
}
