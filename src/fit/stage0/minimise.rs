//! Levenberg–Marquardt on all frames at once.

use super::normal::Normal;
use super::problem::{Problem, Scales};
use super::state::State;

/// Where a descent ended.
pub struct Descent {
    pub state: State,
    pub cost: f64,
    /// False where the caller asked to stop.
    pub finished: bool,
}

/// At most `iterations` accepted steps; ends early once a step gains less than `tolerance` of the cost.
pub fn minimise(
    problem: &Problem,
    start: State,
    scales: &Scales,
    iterations: usize,
    tolerance: f64,
    go_on: &mut dyn FnMut() -> bool,
) -> Descent {
    let mut state = start;
    let mut cost = problem.evaluate(&state, scales, None);
    let mut lambda = 1e-3;
    for _ in 0..iterations {
        if !go_on() {
            return Descent { state, cost, finished: false };
        }
        let layout = &problem.layout;
        let mut normal = Normal::new(state.frames.len(), layout.n_frame, layout.n_shared);
        problem.evaluate(&state, scales, Some(&mut normal));
        let before = cost;
        while lambda < 1e7 {
            if let Some(step) = normal.solve(lambda) {
                let next = state.stepped(layout, &step);
                let next_cost = problem.evaluate(&next, scales, None);
                if next_cost < cost {
                    (state, cost) = (next, next_cost);
                    lambda = (lambda * 0.2).max(1e-7);
                    break;
                }
            }
            lambda *= 6.0;
        }
        if before - cost <= tolerance * before {
            break;
        }
    }
    Descent { state, cost, finished: true }
}
