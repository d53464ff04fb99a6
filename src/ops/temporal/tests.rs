use super::{Temporal, TemporalConfig, cpu};
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

#[test]
fn the_gradient_is_that_of_the_penalty_also_beside_a_jump() {
    let values = motion();
    let mut grads = vec![0.0; values.len()];
    cpu::backward(&CONFIG, &values, &expected(), 1.0, &mut grads);
    assert_gradient("values", &values, &grads, |x| cpu::forward(&CONFIG, x, &expected()));
}

#[test]
fn steady_motion_costs_nothing() {
    let steady: Vec<f64> = (0..28).map(|i| (i / 4) as f64 * 0.2).collect();
    assert!(cpu::forward(&CONFIG, &steady, &[0.0; 28]) < 1e-20);
    let mut shaken = steady.clone();
    shaken[12] += 0.5;
    assert!(cpu::forward(&CONFIG, &shaken, &[0.0; 28]) > 1.0);
}

#[test]
fn an_expected_acceleration_costs_nothing() {
    let mut values: Vec<f64> = (0..28).map(|i| (i / 4) as f64 * 0.2).collect();
    values[18] += 0.2;
    let mut expected = vec![0.0; 28];
    (expected[14], expected[18], expected[22]) = (0.2, -0.4, 0.2);
    assert!(cpu::forward(&CONFIG, &values, &[0.0; 28]) > 1.0);
    assert!(cpu::forward(&CONFIG, &values, &expected) < 1e-20);
}

#[test]
fn two_frames_have_no_acceleration() {
    let mut grads = vec![0.0; 8];
    cpu::backward(&CONFIG, &[0.0, 1.0, 2.0, 3.0, 0.5, 0.5, 0.5, 0.5], &[0.0; 8], 1.0, &mut grads);
    assert_eq!(grads, [0.0; 8]);
}

#[test]
fn the_numbers_before_the_first_are_left_alone() {
    let values = motion();
    let config = TemporalConfig { first: 2, ..CONFIG };
    let (mut all, mut some) = (vec![0.0; values.len()], vec![0.0; values.len()]);
    cpu::backward(&CONFIG, &values, &expected(), 1.0, &mut all);
    cpu::backward(&config, &values, &expected(), 1.0, &mut some);
    for (all, some) in all.chunks(4).zip(some.chunks(4)) {
        assert_eq!(some[..2], [0.0; 2]);
        assert_eq!(some[2..], all[2..]);
    }
    assert_gradient("values", &values, &some, |x| cpu::forward(&config, x, &expected()));
}

#[test]
fn gpu_matches_the_twin() {
    let Some(gpu) = gpu("temporal::gpu_matches_the_twin") else { return };
    let values: Vec<f32> = motion().iter().map(|&x| x as f32).collect();
    let expected: Vec<f32> = expected().iter().map(|&x| x as f32).collect();
    for config in [CONFIG, TemporalConfig { first: 2, ..CONFIG }] {
        let mut want = vec![1.0f32; values.len()];
        cpu::backward(&config, &values, &expected, 0.7, &mut want);
        let (values, grads) = (gpu.upload("values", &values), gpu.upload("grads", &vec![1.0f32; want.len()]));
        let mut recorder = gpu.recorder("temporal/test");
        Temporal::new(&gpu, config, &expected).backward(&mut recorder, &values, 0.7, &grads);
        recorder.submit().unwrap();
        assert_close("grads", &gpu.read(&grads).unwrap(), &want, 1e-5);
    }
}
