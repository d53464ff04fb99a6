//! Reference twin.

use super::AnchorConfig;
use crate::ops::Real;

/// The penalty.
pub fn forward<T: Real>(config: &AnchorConfig, values: &[T], start: &[T]) -> T {
    let scales = config.scales.iter().cycle();
    values.iter().zip(start).zip(scales).map(|((&x, &from), &scale)| ((x - from) / T::of(scale)).powi(2)).sum()
}

/// Adds `weight` times the gradient.
pub fn backward<T: Real>(config: &AnchorConfig, values: &[T], start: &[T], weight: T, grads: &mut [T]) {
    for (i, &scale) in (0..values.len()).zip(config.scales.iter().cycle()) {
        grads[i] += T::of(2.0 / (scale * scale)) * weight * (values[i] - start[i]);
    }
}
