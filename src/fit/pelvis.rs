//! Where the pelvis joint lies. No picture tells: a body that turns about another point lies as it did once its place follows. But
//! a new pose is put down by the pelvis, and there a millimetre is a millimetre of everything. β says where it is, and what β
//! has to explain of wide clothes moves it along. So it is expected anew, from the joints of the limbs alone, which keypoints
//! have found: by those of β that they ask for, held near the mean as stage 0 holds it (docs/lab/fit.md, "Where the pelvis lies").

use glam::{Quat, Vec3};
use nalgebra::{DMatrix, DVector};

use crate::body::joints::{
    LEFT_ANKLE, LEFT_ELBOW, LEFT_HIP, LEFT_KNEE, LEFT_SHOULDER, LEFT_WRIST, RIGHT_ANKLE, RIGHT_ELBOW, RIGHT_HIP,
    RIGHT_KNEE, RIGHT_SHOULDER, RIGHT_WRIST,
};
use crate::body::{Body, N_POSE};

/// Hips, whose middle all places are told from, and the limbs' joints, hips among them.
const HIPS: [usize; 2] = [LEFT_HIP, RIGHT_HIP];
const LIMBS: [usize; 12] = [
    LEFT_HIP,
    RIGHT_HIP,
    LEFT_KNEE,
    RIGHT_KNEE,
    LEFT_ANKLE,
    RIGHT_ANKLE,
    LEFT_SHOULDER,
    RIGHT_SHOULDER,
    LEFT_ELBOW,
    RIGHT_ELBOW,
    LEFT_WRIST,
    RIGHT_WRIST,
];

/// How far joints that keypoints have found lie off, standard deviation, metres.
const JOINTS_OFF: f64 = 5e-3;

/// Moves the pelvis joint of `body` to where it is expected, for a person of `betas`. Places `transl [N, 3]` follow, so that the body in
/// `poses [N, 72]` stays where it is. How far it has moved, metres in the T-pose.
pub fn settle(body: &mut Body, betas: &[f32], poses: &[f32], transl: &mut [f32]) -> [f32; 3] {
    if body.n_betas == 0 {
        return [0.0; 3];
    }
    let found = joints(body, betas);
    let moved = middle(&found) + expected(body, &found) - found[0];
    (0..3).for_each(|axis| body.j_template[0][axis] += moved[axis]);
    let (poses, places) = (poses.as_chunks::<N_POSE>().0, transl.as_chunks_mut::<3>().0);
    for (pose, place) in poses.iter().zip(places) {
        let turn = Quat::from_scaled_axis(Vec3::from_slice(pose));
        *place = (Vec3::from(*place) + turn * moved - moved).to_array();
    }
    moved.to_array()
}

fn joints(body: &Body, betas: &[f32]) -> Vec<Vec3> {
    body.shaped_joints(betas).into_iter().map(Vec3::from).collect()
}

fn middle(joints: &[Vec3]) -> Vec3 {
    0.5 * (joints[HIPS[0]] + joints[HIPS[1]])
}

/// From the middle of the hips to the pelvis, of the likeliest body with limbs like those of `found`.
fn expected(body: &Body, found: &[Vec3]) -> Vec3 {
    let limbs = |joints: &[Vec3]| -> Vec<f64> {
        let middle = middle(joints);
        LIMBS.iter().flat_map(|&j| (joints[j] - middle).to_array()).map(f64::from).collect()
    };
    let mean = limbs(&joints(body, &[]));
    let off = |joints: &[Vec3]| DVector::from_iterator(mean.len(), limbs(joints).iter().zip(&mean).map(|(a, b)| a - b));
    let component = |k: usize| {
        let mut betas = vec![0.0; body.n_betas];
        betas[k] = 1.0;
        off(&joints(body, &betas))
    };
    let rows = DMatrix::from_columns(&(0..body.n_betas).map(component).collect::<Vec<_>>()) / JOINTS_OFF;
    let normal = rows.transpose() * &rows + DMatrix::identity(body.n_betas, body.n_betas);
    let right = rows.transpose() * off(found) / JOINTS_OFF;
    let betas = normal.cholesky().map_or_else(|| DVector::zeros(body.n_betas), |factors| factors.solve(&right));
    let likeliest = joints(body, &betas.iter().map(|&b| b as f32).collect::<Vec<_>>());
    likeliest[0] - middle(&likeliest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::N_JOINTS;
    use crate::ops::skinning::cpu::forward;

    /// Components that move the pelvis up by some centimetres: with all other joints, as a larger body does, and alone, as girth does to
    /// a lesser degree.
    const SIZE: usize = 0;
    const GIRTH: usize = 1;
    const UP: [f32; 2] = [0.02, 0.03];

    fn body() -> Body {
        let mut body = Body::test_body();
        for joint in 0..N_JOINTS {
            for axis in 0..3 {
                body.j_shapedirs[(3 * joint + axis) * body.n_betas + GIRTH] = 0.0;
            }
        }
        for component in [SIZE, GIRTH] {
            body.j_shapedirs[body.n_betas + component] += UP[component];
        }
        body
    }

    #[test]
    fn girth_alone_does_not_move_the_pelvis() {
        let mut wide = body();
        let (mean, betas) = (wide.shaped_joints(&[])[0], [0.0, 2.5, 0.0]);
        assert!((wide.shaped_joints(&betas)[0][1] - mean[1] - 2.5 * UP[GIRTH]).abs() < 1e-6);
        settle(&mut wide, &betas, &[], &mut []);
        let settled = wide.shaped_joints(&betas)[0];
        assert!((0..3).all(|k| (settled[k] - mean[k]).abs() < 1e-5), "{settled:?}, expected {mean:?}");
    }

    #[test]
    fn a_pelvis_that_limbs_account_for_stays() {
        let mut large = body();
        let betas = [1.5, 0.0, -1.0];
        let before = large.shaped_joints(&betas);
        assert!(before[0][1] - large.j_template[0][1] > 0.02, "size moves the pelvis");
        settle(&mut large, &betas, &[], &mut []);
        let off = Vec3::from(large.shaped_joints(&betas)[0]).distance(before[0].into());
        assert!(off < 2e-3, "{off} m");
    }

    #[test]
    fn the_posed_body_stays_where_it_is() {
        let mut body = body();
        let (betas, mut pose) = ([0.4, -2.0, 0.7], [0.0; N_POSE]);
        (0..N_POSE).for_each(|k| pose[k] = 0.3 * (k as f32 * 1.7).sin());
        pose[1] = 2.4;
        let mut transl = [0.2, -0.1, 3.0];
        let before = forward(&body, &betas, None, &pose, transl).vertices;
        let pelvis = body.shaped_joints(&betas)[0];
        settle(&mut body, &betas, &pose, &mut transl);
        assert!(Vec3::from(pelvis).distance(body.shaped_joints(&betas)[0].into()) > 0.05);
        let after = forward(&body, &betas, None, &pose, transl).vertices;
        let far = |(a, b): (&[f32; 3], &[f32; 3])| Vec3::from(*a).distance(Vec3::from(*b));
        let most = before.iter().zip(&after).map(far).fold(0.0, f32::max);
        assert!(most < 1e-5, "{most} m");
    }
}
