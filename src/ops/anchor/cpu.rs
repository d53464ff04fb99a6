//! Reference twin.

use super::AnchorConfig;
use crate::ops::Real;

/// The penalty.
pub fn forward<T: Real>(config: &AnchorConfig, values: &[T], start: &[T]) -> T {
    let pairs = values.iter().zip(start).enumerate().filter(|(i, _)| i % config.stride >= config.first);
    pairs.map(|(_, (&x, &from))| ((x - from) / T::of(config.scale)).powi(2)).sum()
}

/// Adds `weight` times the gradient.
pub fn backward<T: Real>(config: &AnchorConfig, values: &[T], start: &[T], weight: T, grads: &mut [T]) {
    let factor = T::of(2.0 / (config.scale * config.scale)) * weight;
    for i in (0..values.len()).filter(|i| i % config.stride >= config.first) {
        grads[i] += factor * (values[i] - start[i]);
    }
}
