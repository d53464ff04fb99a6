//! Reference twin.

use super::{Given, TemporalConfig};
use crate::ops::Real;

/// Beyond the expected one.
fn acceleration<T: Real>(config: &TemporalConfig, values: &[T], given: Given<'_, T>, frame: usize, k: usize) -> T {
    let at = |frame: usize| values[frame * config.stride + k];
    if k < config.first || frame == 0 || (frame + 1) * config.stride >= values.len() {
        return T::zero();
    }
    let [beta, alpha] = given.spacing[frame].map(T::of);
    let (before, after) = (at(frame) - at(frame - 1), at(frame + 1) - at(frame));
    if before.abs().max(after.abs()) <= T::of(config.max_change) {
        alpha * after - beta * before - given.expected[frame * config.stride + k]
    } else {
        T::zero()
    }
}

/// The penalty.
pub fn forward<T: Real>(config: &TemporalConfig, values: &[T], given: Given<'_, T>) -> T {
    let cells = (0..values.len() / config.stride).flat_map(|f| (0..config.stride).map(move |k| (f, k)));
    cells.map(|(f, k)| (acceleration(config, values, given, f, k) / T::of(config.scale)).powi(2)).sum()
}

/// Adds `weight` times the gradient.
pub fn backward<T: Real>(config: &TemporalConfig, values: &[T], given: Given<'_, T>, weight: T, grads: &mut [T]) {
    let factor = T::of(2.0 / (config.scale * config.scale)) * weight;
    let n = values.len() / config.stride;
    for frame in 0..n {
        for k in 0..config.stride {
            let at = |frame: usize| acceleration(config, values, given, frame, k);
            let [beta, alpha] = given.spacing[frame].map(T::of);
            let mut pull = -(alpha + beta) * at(frame);
            if frame + 1 < n {
                pull += T::of(given.spacing[frame + 1][0]) * at(frame + 1);
            }
            if frame > 0 {
                pull += T::of(given.spacing[frame - 1][1]) * at(frame - 1);
            }
            grads[frame * config.stride + k] += factor * pull;
        }
    }
}
