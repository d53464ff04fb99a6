//! Reference twin.

use crate::body::{KeypointSet, KeypointSource};
use crate::ops::Real;
use crate::ops::linear::{Vector, accumulate, add, scale};

/// The sources of one keypoint: indices, and whether they are joints.
fn sources(source: &KeypointSource) -> (&[u32], bool) {
    match source {
        KeypointSource::Joint(j) => (std::slice::from_ref(j), true),
        KeypointSource::Joints(joints) => (joints, true),
        KeypointSource::Vertices(vertices) => (vertices, false),
    }
}

/// Keypoints `[K]` of a posed body.
pub fn gather<T: Real>(set: &KeypointSet, vertices: &[Vector<T>], joints: &[Vector<T>]) -> Vec<Vector<T>> {
    let point = |source: &KeypointSource| {
        let (indices, are_joints) = sources(source);
        let from = if are_joints { joints } else { vertices };
        let sum = indices.iter().fold([T::zero(); 3], |sum, &i| add(sum, from[i as usize]));
        scale(T::one() / T::of(indices.len().max(1) as f64), sum)
    };
    set.points.iter().map(point).collect()
}

/// Adds to the gradients of the sources.
pub fn gather_backward<T: Real>(
    set: &KeypointSet,
    grad_keypoints: &[Vector<T>],
    grad_vertices: &mut [Vector<T>],
    grad_joints: &mut [Vector<T>],
) {
    for (source, &grad) in set.points.iter().zip(grad_keypoints) {
        let (indices, are_joints) = sources(source);
        let share = scale(T::one() / T::of(indices.len().max(1) as f64), grad);
        for &i in indices {
            let to = if are_joints { &mut grad_joints[i as usize] } else { &mut grad_vertices[i as usize] };
            accumulate(to, share);
        }
    }
}

/// For each keypoint that was seen: its index, confidence, difference and `1 + r²/ρ²`.
fn differences<T: Real>(
    screen: &[[T; 2]],
    targets: &[[T; 3]],
    rho_px: Option<T>,
) -> impl Iterator<Item = (usize, T, [T; 2], T)> {
    let inverse_rho2 = rho_px.map_or(T::zero(), |rho| T::one() / (rho * rho));
    let seen = screen.iter().zip(targets).enumerate().filter(|(_, (_, target))| target[2] > T::zero());
    seen.map(move |(k, (&[x, y], &[u, v, confidence]))| {
        let d = [x - u, y - v];
        (k, confidence, d, T::one() + (d[0] * d[0] + d[1] * d[1]) * inverse_rho2)
    })
}

/// The loss of one frame: `screen [K]`, `targets [K]`.
pub fn forward<T: Real>(screen: &[[T; 2]], targets: &[[T; 3]], rho_px: Option<T>) -> T {
    differences(screen, targets, rho_px).map(|(_, c, [x, y], damping)| c * (x * x + y * y) / damping).sum()
}

/// Adds λ times the gradient to `grad_screen`.
pub fn backward<T: Real>(
    screen: &[[T; 2]],
    targets: &[[T; 3]],
    rho_px: Option<T>,
    weight: T,
    grad_screen: &mut [[T; 2]],
) {
    for (k, confidence, d, damping) in differences(screen, targets, rho_px) {
        let factor = T::of(2.0) * weight * confidence / (damping * damping);
        grad_screen[k][0] += factor * d[0];
        grad_screen[k][1] += factor * d[1];
    }
}
