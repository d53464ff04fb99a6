use std::f64::consts::PI;

use glam::{DMat3, DQuat};

use super::{AngularAcceleration, AngularAccelerationConfig, Given, cpu};
use crate::ops::temporal::{self, TemporalConfig};
use crate::ops::testing::{assert_close, assert_gradient, f32s, gpu, random};

const CONFIG: AngularAccelerationConfig = AngularAccelerationConfig { stride: 5, scale: 0.3, max_turn: 1.0 };

/// Rows of `stride` numbers that begin with the rotation vectors, at most π long.
fn rows(stride: usize, rotations: impl Iterator<Item = DMat3>) -> Vec<f64> {
    let rest = random(3, stride);
    let row = |r: DMat3| [&DQuat::from_mat3(&r).to_scaled_axis().to_array()[..], &rest[3..]].concat();
    rotations.flat_map(row).collect()
}

/// Upright before a camera whose y runs down, turned by `angle` about the body's own axis.
fn upright(angle: f64) -> DMat3 {
    DMat3::from_rotation_x(PI) * DMat3::from_rotation_y(angle)
}

fn even(n: usize) -> Vec<[f64; 2]> {
    temporal::spacing(&(0..n).map(|i| i as f64).collect::<Vec<_>>())
}

/// Nothing expected of up to 24 frames.
const NONE: [f64; 72] = [0.0; 72];

fn given(spacing: &[[f64; 2]]) -> Given<'_, f64> {
    Given { expected: &NONE, spacing }
}

/// Times of nine frames that follow unevenly.
const UNEVEN: [f64; 9] = [0.0, 1.0, 3.0, 4.0, 6.0, 9.0, 10.0, 11.0, 13.0];

/// Nine frames of somebody who sways in a turn, with a gap before the seventh.
fn swaying() -> Vec<f64> {
    let sway = random(5, 27);
    let angle = |t: usize| 0.3 * t as f64 + if t < 6 { 0.0 } else { 1.3 };
    let lean = |t: usize| DMat3::from_rotation_z(0.2 * sway[3 * t]) * DMat3::from_rotation_x(0.2 * sway[3 * t + 1]);
    rows(CONFIG.stride, (0..9).map(|t| upright(angle(t) + 0.1 * sway[3 * t + 2]) * lean(t)))
}

#[test]
fn the_gradient_is_that_of_the_penalty_also_beside_a_gap() {
    let values = swaying();
    let expected = random(7, 27);
    for (spacing, expected) in [(even(9), &NONE[..27]), (temporal::spacing(&UNEVEN), &NONE[..27]), (even(9), &expected)]
    {
        let mut grads = vec![0.0; values.len()];
        let given = Given { expected, spacing: &spacing };
        cpu::backward(&CONFIG, &values, given, 1.0, &mut grads);
        assert_gradient("values", &values, &grads, |x| cpu::forward(&CONFIG, x, given));
        assert!(grads.chunks(CONFIG.stride).all(|row| row[3..] == [0.0; 2]), "the rest of a row has no part in it");
        let turn_of = |frame: usize| &grads[CONFIG.stride * frame..][..3];
        assert!((0..9).all(|frame| turn_of(frame) != [0.0; 3]));
    }
}

#[test]
fn steady_turning_costs_nothing_however_one_leans() {
    let config = AngularAccelerationConfig { stride: 3, ..CONFIG };
    let lean = DMat3::from_rotation_z(0.2) * DMat3::from_rotation_x(-0.1);
    let of_body: Vec<f64> = rows(3, (0..20).map(|t| upright(0.3 * f64::from(t)) * lean));
    let of_world: Vec<f64> = rows(3, (0..20).map(|t| lean * upright(0.3 * f64::from(t))));
    for values in [&of_body, &of_world] {
        assert!(cpu::forward(&config, values, given(&even(20))) < 1e-20);
    }
    let nodding =
        rows(3, (0..20).map(|t| upright(0.3 * f64::from(t)) * DMat3::from_rotation_x(0.1 * f64::from(t % 2))));
    assert!(cpu::forward(&config, &nodding, given(&even(20))) > 5.0);
}

#[test]
fn turning_is_as_steady_as_it_is_in_time() {
    let config = AngularAccelerationConfig { stride: 3, ..CONFIG };
    let turn = rows(3, UNEVEN.iter().map(|t| upright(0.1 * t)));
    let (uneven, even) = (temporal::spacing(&UNEVEN), even(9));
    // The sine of a turn is not quite the turn.
    let cost = |spacing: &[[f64; 2]]| cpu::forward(&config, &turn, given(spacing));
    assert!(cost(&uneven) < 1e-3 * cost(&even) && cost(&even) > 0.5, "{} and {}", cost(&uneven), cost(&even));
}

/// Why this is not left to [`temporal`].
#[test]
fn the_ends_of_a_steady_turn_are_left_alone() {
    let turn = rows(3, (0..24).map(|t| upright(PI / 12.0 * (f64::from(t) - 11.5))));
    let mut grads = vec![0.0; turn.len()];
    cpu::backward(&AngularAccelerationConfig { stride: 3, ..CONFIG }, &turn, given(&even(24)), 1.0, &mut grads);
    assert!(grads.iter().all(|g| g.abs() < 1e-12), "{grads:?}");
    temporal::cpu::backward(
        &TemporalConfig { stride: 3, first: 0, scale: 0.3, max_change: 1.0 },
        &turn,
        Given { expected: &vec![0.0; turn.len()], spacing: &even(24) },
        1.0,
        &mut grads,
    );
    let pull = |frame: usize| grads[3 * frame..][..3].iter().map(|g| g * g).sum::<f64>().sqrt();
    assert!(pull(0) > 5.0 * pull(12) && pull(0) > 0.5, "{} and {}", pull(0), pull(12));
}

#[test]
fn what_is_expected_costs_nothing_and_what_is_small_is_not() {
    let config = AngularAccelerationConfig { stride: 3, ..CONFIG };
    // Steady, then still, with a tremble.
    let angle = |t: usize| 0.3 * t.min(5) as f64 + 0.01 * (t % 2) as f64;
    let stops = rows(3, (0..10).map(|t| upright(angle(t))));
    let spacing = even(10);
    let large = cpu::large(&config, &stops, &spacing, 0.1);
    let at: Vec<usize> = (0..10).filter(|t| large[3 * t..][..3] != [0.0; 3]).collect();
    assert_eq!(at, [5], "{large:?}");
    let cost = |expected: &[f64]| cpu::forward(&config, &stops, Given { expected, spacing: &spacing });
    let (left, whole) = (cost(&large), cost(&NONE[..30]));
    assert!(left > 0.0 && left < 0.05 * whole, "{left} of {whole}");
}

#[test]
fn two_frames_have_no_acceleration() {
    let mut grads = vec![0.0; 10];
    cpu::backward(&CONFIG, &swaying()[..10], given(&even(2)), 1.0, &mut grads);
    assert_eq!(grads, [0.0; 10]);
    cpu::backward(&CONFIG, &[], given(&[]), 1.0, &mut []);
    assert_eq!(cpu::forward(&CONFIG, &[], given(&[])), 0.0);
}

#[test]
fn gpu_matches_the_twin() {
    let Some(gpu) = gpu("angular_acceleration::gpu_matches_the_twin") else { return };
    let values = f32s(&swaying());
    let mut want = vec![1.0f32; values.len()];
    let (expected, spacing) = (f32s(&random(7, 27)), temporal::spacing(&UNEVEN));
    let given = Given { expected: &expected, spacing: &spacing };
    cpu::backward(&CONFIG, &values, given, 0.7, &mut want);
    let (values, grads) = (gpu.upload("values", &values), gpu.upload("grads", &vec![1.0f32; want.len()]));
    let mut recorder = gpu.recorder("angular_acceleration/test");
    AngularAcceleration::new(&gpu, CONFIG, given).backward(&mut recorder, &values, 0.7, &grads);
    recorder.submit().unwrap();
    assert_close("grads", &gpu.read(&grads).unwrap(), &want, 1e-5);
}
