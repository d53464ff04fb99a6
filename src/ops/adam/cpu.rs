//! Reference twin.

use super::AdamConfig;
use crate::ops::Real;

/// One step, `step` counted from 1.
pub fn step<T: Real>(
    config: &AdamConfig,
    lr: T,
    step: u32,
    params: &mut [T],
    grads: &[T],
    exp_avg: &mut [T],
    exp_avg_sq: &mut [T],
) {
    let (beta1, beta2, eps) = (T::of(config.beta1), T::of(config.beta2), T::of(config.eps));
    let correction1 = T::of(1.0 - config.beta1.powi(step as i32));
    let correction2 = T::of(1.0 - config.beta2.powi(step as i32));
    for i in 0..params.len() {
        exp_avg[i] = beta1 * exp_avg[i] + (T::one() - beta1) * grads[i];
        exp_avg_sq[i] = beta2 * exp_avg_sq[i] + (T::one() - beta2) * grads[i] * grads[i];
        let m = exp_avg[i] / correction1;
        let v = exp_avg_sq[i] / correction2;
        params[i] -= lr * m / (v.sqrt() + eps);
    }
}

/// One step of uniform Adam (Nicolet et al. 2021) over `[V, 3]`: the second moment is one number, the running mean of
/// the largest squared gradient of a vertex.
pub fn uniform_step<T: Real>(
    config: &AdamConfig,
    lr: T,
    step: u32,
    params: &mut [T],
    grads: &[T],
    exp_avg: &mut [T],
    exp_avg_sq: &mut T,
) {
    let (beta1, beta2, eps) = (T::of(config.beta1), T::of(config.beta2), T::of(config.eps));
    let correction1 = T::of(1.0 - config.beta1.powi(step as i32));
    let correction2 = T::of(1.0 - config.beta2.powi(step as i32));
    let largest = grads.chunks_exact(3).map(|g| g.iter().map(|&x| x * x).sum::<T>()).fold(T::zero(), T::max);
    *exp_avg_sq = beta2 * *exp_avg_sq + (T::one() - beta2) * largest;
    for i in 0..params.len() {
        exp_avg[i] = beta1 * exp_avg[i] + (T::one() - beta1) * grads[i];
        params[i] -= lr * (exp_avg[i] / correction1) / ((*exp_avg_sq / correction2).sqrt() + eps);
    }
}
