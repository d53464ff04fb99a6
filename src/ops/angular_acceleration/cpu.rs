//! Reference twin.

use super::AngularAccelerationConfig;
use crate::ops::Real;
use crate::ops::linear::{Matrix, Vector, accumulate, add_matrix, dot, product, scale, sub, transpose};
use crate::ops::skinning::{rodrigues, rodrigues_backward};

/// The rotations of a clip with the turns between them.
struct Turns<'a, T> {
    spacing: &'a [[f64; 2]],
    rotations: Vec<Matrix<T>>,
    /// `[N − 1]`: s of each frame and the next; `None` over a gap.
    steps: Vec<Option<Vector<T>>>,
}

impl<'a, T: Real> Turns<'a, T> {
    fn new(config: &AngularAccelerationConfig, values: &[T], spacing: &'a [[f64; 2]]) -> Self {
        let vectors = values.chunks_exact(config.stride).map(|row| [row[0], row[1], row[2]]);
        let rotations: Vec<Matrix<T>> = vectors.map(rodrigues).collect();
        let least_trace = T::of(1.0 + 2.0 * config.max_turn.cos());
        let step = |pair: &[Matrix<T>]| {
            let q = product(&transpose(&pair[0]), &pair[1]);
            let axis = [q[2][1] - q[1][2], q[0][2] - q[2][0], q[1][0] - q[0][1]];
            (q[0][0] + q[1][1] + q[2][2] >= least_trace).then(|| scale(T::of(0.5), axis))
        };
        let steps = rotations.windows(2).map(step).collect();
        Self { spacing, rotations, steps }
    }

    /// α s of `frame` less β s of the frame before; zero at the clip's ends and beside a gap.
    fn acceleration(&self, frame: usize) -> Vector<T> {
        let Some([beta, alpha]) = self.spacing.get(frame).map(|factors| factors.map(T::of)) else {
            return [T::zero(); 3];
        };
        let before = frame.checked_sub(1).and_then(|before| self.steps[before]);
        let after = self.steps.get(frame).copied().flatten();
        before.zip(after).map_or([T::zero(); 3], |(before, after)| sub(scale(alpha, after), scale(beta, before)))
    }
}

/// The penalty.
pub fn forward<T: Real>(config: &AngularAccelerationConfig, values: &[T], spacing: &[[f64; 2]]) -> T {
    let turns = Turns::new(config, values, spacing);
    let costs = (0..turns.rotations.len()).map(|frame| turns.acceleration(frame)).map(|a| dot(a, a));
    costs.sum::<T>() / T::of(config.scale * config.scale)
}

/// Adds `weight` times the gradient.
pub fn backward<T: Real>(
    config: &AngularAccelerationConfig,
    values: &[T],
    spacing: &[[f64; 2]],
    weight: T,
    grads: &mut [T],
) {
    let turns = Turns::new(config, values, spacing);
    let factor = T::of(2.0 / (config.scale * config.scale)) * weight;
    // The gradient by Q of the turn from `frame` to the next.
    let by_turn = |frame: usize| {
        let (alpha, beta) = (T::of(spacing[frame][1]), T::of(spacing[frame + 1][0]));
        let by_step = sub(scale(alpha, turns.acceleration(frame)), scale(beta, turns.acceleration(frame + 1)));
        let [x, y, z] = scale(T::of(0.5) * factor, by_step);
        [[T::zero(), -z, y], [z, T::zero(), -x], [-y, x, T::zero()]]
    };
    let (rotations, n) = (&turns.rotations, turns.rotations.len());
    for (frame, grads) in grads.chunks_exact_mut(config.stride).enumerate() {
        let mut by_rotation = [[T::zero(); 3]; 3];
        if frame + 1 < n {
            by_rotation = product(&rotations[frame + 1], &transpose(&by_turn(frame)));
        }
        if frame > 0 {
            by_rotation = add_matrix(&by_rotation, &product(&rotations[frame - 1], &by_turn(frame - 1)));
        }
        let at = frame * config.stride;
        let mut grad = [grads[0], grads[1], grads[2]];
        accumulate(&mut grad, rodrigues_backward([values[at], values[at + 1], values[at + 2]], &by_rotation));
        grads[..3].copy_from_slice(&grad);
    }
}
