//! What the operators' tests share: the device, the golden values, tolerances, central differences.

use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

use super::Real;
use crate::gpu::{DeviceSelect, Gpu};
use crate::npz::Npz;

/// The tests' device, or `None` after saying that `test` is ignored. In CI (`CI` set) a device is required.
pub fn gpu(test: &str) -> Option<Arc<Gpu>> {
    static GPU: OnceLock<Result<Arc<Gpu>, String>> = OnceLock::new();
    match GPU.get_or_init(|| Gpu::open(&DeviceSelect::Auto).map_err(|e| e.to_string())) {
        Ok(gpu) => {
            eprintln!("{test}: on {}", gpu.info().name);
            Some(gpu.clone())
        }
        Err(reason) => {
            assert!(std::env::var_os("CI").is_none(), "{test}: CI requires a device: {reason}");
            eprintln!("{test}: ignored, {reason}");
            None
        }
    }
}

/// A golden archive: from `EFFIGY_GOLDEN_DIR`, else the committed fixtures.
pub fn golden(name: &str) -> Npz {
    let folder = std::env::var_os("EFFIGY_GOLDEN_DIR").map(PathBuf::from);
    let folder = folder.unwrap_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/golden"));
    Npz::open(&folder.join(name)).unwrap_or_else(|e| panic!("{}: {e}", folder.join(name).display()))
}

/// `n` numbers between −1 and 1, the same in every run.
pub fn random(seed: u64, n: usize) -> Vec<f64> {
    use rand::{RngExt, SeedableRng};
    let mut rng = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
    (0..n).map(|_| rng.random_range(-1.0..1.0)).collect()
}

/// Flat numbers as points.
pub fn points<T: Copy, const N: usize>(flat: &[T]) -> Vec<[T; N]> {
    let (points, rest) = flat.as_chunks();
    assert!(rest.is_empty(), "{} numbers are not points of {N}", flat.len());
    points.to_vec()
}

/// The numbers as the device sees them.
pub fn f32s(x: &[f64]) -> Vec<f32> {
    x.iter().map(|&x| x as f32).collect()
}

/// Tolerance of values against the golden ones, and of gradients.
pub const VALUE: f64 = 1e-4;
pub const GRADIENT: f64 = 1e-3;

/// Fails unless `‖ours − want‖ / ‖want‖ ≤ tolerance`; NaN and infinity never pass.
#[track_caller]
pub fn assert_close<A: Real, B: Real>(what: &str, ours: &[A], want: &[B], tolerance: f64) {
    assert_eq!(ours.len(), want.len(), "{what}: length");
    let (mut difference, mut norm) = (0.0, 0.0);
    for (i, (a, b)) in ours.iter().zip(want).enumerate() {
        assert!(a.is_finite(), "{what}[{i}] is {a:?}");
        difference += (a.f64() - b.f64()).powi(2);
        norm += b.f64().powi(2);
    }
    let error = difference.sqrt() / norm.sqrt().max(1e-30);
    assert!(difference == 0.0 || error <= tolerance, "{what}: relative error {error:.3e}, allowed {tolerance:.0e}");
}

/// Fails unless `gradient` agrees with central differences of `loss` at `x` in f64: every entry within
/// `1e-5 + 1e-5·|difference|` for a step of 1e-6 scaled to the entry. All failures are listed.
#[track_caller]
pub fn assert_gradient(what: &str, x: &[f64], gradient: &[f64], mut loss: impl FnMut(&[f64]) -> f64) {
    assert_eq!(x.len(), gradient.len(), "{what}: length");
    let mut moved = x.to_vec();
    let mut failures = Vec::new();
    for i in 0..x.len() {
        let h = 1e-6 * x[i].abs().max(1.0);
        moved[i] = x[i] + h;
        let above = loss(&moved);
        moved[i] = x[i] - h;
        let below = loss(&moved);
        moved[i] = x[i];
        let numeric = (above - below) / (2.0 * h);
        if (gradient[i] - numeric).abs() > 1e-5 + 1e-5 * numeric.abs() || !gradient[i].is_finite() {
            failures.push(format!("{what}[{i}]: gradient {}, central difference {numeric}", gradient[i]));
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

/// `n` values in [−1, 1) that look random.
pub fn noise(n: usize, seed: u64) -> Vec<f64> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    };
    (0..n).map(|_| next()).collect()
}

/// A closed bumpy ball of about `2·n·n` faces, half a metre in radius, three metres before the camera: `(view, faces)`.
pub fn bumpy_surface(n: usize) -> (Vec<f64>, Vec<[u32; 3]>) {
    let mut view = Vec::new();
    for i in 0..n * n {
        let (a, b) = ((i / n) as f64 / (n - 1) as f64, (i % n) as f64 / n as f64);
        let (theta, phi) = (std::f64::consts::PI * (0.02 + 0.96 * a), std::f64::consts::TAU * b);
        let r = 0.5 + 0.06 * (9.0 * theta).sin() * (7.0 * phi).cos();
        view.extend([r * theta.sin() * phi.cos(), -r * theta.cos(), 3.0 + r * theta.sin() * phi.sin()]);
    }
    let at = |i: usize, j: usize| (i * n + j % n) as u32;
    let quad = |(i, j)| [[at(i, j), at(i, j + 1), at(i + 1, j)], [at(i + 1, j), at(i, j + 1), at(i + 1, j + 1)]];
    (view, (0..n - 1).flat_map(|i| (0..n).map(move |j| (i, j))).flat_map(quad).collect())
}
