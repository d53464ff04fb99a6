//! Reference twin.

use super::{AngularAccelerationConfig, Given};
use crate::ops::Real;
use crate::ops::linear::{Matrix, Vector, accumulate, add_matrix, dot, product, scale, sub, transpose};
use crate::ops::skinning::{rodrigues, rodrigues_backward};

/// The rotations of a clip with the turns between them.
struct Turns<'a, T> {
    given: Given<'a, T>,
    rotations: Vec<Matrix<T>>,
    /// `[N − 1]`: s of each frame and the next; `None` over a gap.
    steps: Vec<Option<Vector<T>>>,
}

impl<'a, T: Real> Turns<'a, T> {
    fn new(config: &AngularAccelerationConfig, values: &[T], given: Given<'a, T>) -> Self {
        let vectors = values.chunks_exact(config.stride).map(|row| [row[0], row[1], row[2]]);
        let rotations: Vec<Matrix<T>> = vectors.map(rodrigues).collect();
        let least_trace = T::of(1.0 + 2.0 * config.max_turn.cos());
        let step = |pair: &[Matrix<T>]| {
            let q = product(&transpose(&pair[0]), &pair[1]);
            let axis = [q[2][1] - q[1][2], q[0][2] - q[2][0], q[1][0] - q[0][1]];
            (q[0][0] + q[1][1] + q[2][2] >= least_trace).then(|| scale(T::of(0.5), axis))
        };
        let steps = rotations.windows(2).map(step).collect();
        Self { given, rotations, steps }
    }

    /// α s of `frame` less β s of the frame before, beyond the expected one; zero at the clip's ends and beside a gap.
    fn acceleration(&self, frame: usize) -> Vector<T> {
        let Some([beta, alpha]) = self.given.spacing.get(frame).map(|factors| factors.map(T::of)) else {
            return [T::zero(); 3];
        };
        let before = frame.checked_sub(1).and_then(|before| self.steps[before]);
        let after = self.steps.get(frame).copied().flatten();
        let Some((before, after)) = before.zip(after) else { return [T::zero(); 3] };
        let expected = std::array::from_fn(|k| self.given.expected[3 * frame + k]);
        sub(sub(scale(alpha, after), scale(beta, before)), expected)
    }
}

/// The penalty.
pub fn forward<T: Real>(config: &AngularAccelerationConfig, values: &[T], given: Given<'_, T>) -> T {
    let turns = Turns::new(config, values, given);
    let costs = (0..turns.rotations.len()).map(|frame| turns.acceleration(frame)).map(|a| dot(a, a));
    costs.sum::<T>() / T::of(config.scale * config.scale)
}

/// Adds `weight` times the gradient.
pub fn backward<T: Real>(
    config: &AngularAccelerationConfig,
    values: &[T],
    given: Given<'_, T>,
    weight: T,
    grads: &mut [T],
) {
    let turns = Turns::new(config, values, given);
    let factor = T::of(2.0 / (config.scale * config.scale)) * weight;
    // The gradient by Q of the turn from `frame` to the next.
    let by_turn = |frame: usize| {
        let (alpha, beta) = (T::of(given.spacing[frame][1]), T::of(given.spacing[frame + 1][0]));
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

/// `[N, 3]`: the accelerations of `values`, those of a length up to `least` left out; for [`Given::expected`].
pub fn large<T: Real>(config: &AngularAccelerationConfig, values: &[T], spacing: &[[f64; 2]], least: f64) -> Vec<T> {
    let none = vec![T::zero(); 3 * spacing.len()];
    let turns = Turns::new(config, values, Given { expected: &none, spacing });
    let accelerations = (0..spacing.len()).map(|frame| turns.acceleration(frame));
    accelerations.flat_map(|a| if dot(a, a) > T::of(least * least) { a } else { [T::zero(); 3] }).collect()
}
