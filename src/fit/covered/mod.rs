//! Toes in shoes and ears under hair. Offsets are smooth, so a naked body's toes and ears would show through whatever covers
//! them, as a relief that no picture has. None of it is in the paper. Here the clip's colours tell what is covered, and the body's
//! template loses that relief: feet end in a cap, the head's side goes on over the ear.

mod ear_patch;
mod seen;
mod toe_cap;

use glam::Vec3;

use crate::body::joints::{LEFT_ANKLE, LEFT_FOOT, RIGHT_ANKLE, RIGHT_FOOT};
use crate::body::{Body, KeypointSource};
use crate::capture::Capture;
use crate::fit::stage0::Stage0Result;
use crate::keypoints::{COCO17, Part, Side, index_of};
use crate::ops::Topology;

/// Ankle and foot: left, right.
const FEET: [[usize; 2]; 2] = [[LEFT_ANKLE, LEFT_FOOT], [RIGHT_ANKLE, RIGHT_FOOT]];
/// Part of a vertex' weight from which on it belongs to the toes.
const OF_TOES: f32 = 0.5;

/// What of a body something covers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Covered {
    pub toes: bool,
    pub ears: bool,
}

impl Covered {
    /// Compares the colours of toes and ears with the face's, as the clip shows them where stage 0's naked body has them.
    /// Both sides are decided together. What is not seen is not covered.
    pub fn find(body: &Body, capture: &Capture, start: &Stage0Result) -> Self {
        let Some(head) = Head::of(body, &start.betas) else { return Self::default() };
        let colours = seen::colours(body, capture, start, &head);
        let differs = |part: Option<[f32; 3]>| {
            part.zip(colours.face).is_some_and(|(part, face)| seen::is_other_than_skin(part, face))
        };
        tracing::debug!(?colours, "what the clip shows of face, toes and ears");
        Self { toes: differs(colours.toes), ears: differs(colours.ears) }
    }

    /// Takes the relief of what is covered out of the template, before its shape is fitted: the surface finds that of shoes and
    /// hair from there. Components of the shape and joints stay.
    pub fn even_out(&self, body: &mut Body, betas: &[f32]) {
        let shaped: Vec<Vec3> = body.shaped_vertices(betas).into_iter().map(Vec3::from).collect();
        let mut even = shaped.clone();
        let topology = Topology::new(body.n_vertices(), &body.faces);
        if self.toes {
            let joints = body.shaped_joints(betas);
            for [ankle, foot] in FEET {
                toe_cap::cap(&mut even, body, &topology, [ankle, foot], [joints[ankle].into(), joints[foot].into()]);
            }
        }
        if let Some(head) = Head::of(body, betas).filter(|_| self.ears) {
            for side in 0..2 {
                ear_patch::patch(&mut even, &body.faces, &topology, head.ear_vertices[side], head.ears[1 - side]);
            }
        }
        for (template, (even, shaped)) in body.v_template.iter_mut().zip(even.iter().zip(&shaped)) {
            *template = (Vec3::from(*template) + (*even - *shaped)).into();
        }
    }
}

/// The mean of a vertex' neighbours.
fn mean_around(vertices: &[Vec3], topology: &Topology, v: usize) -> Vec3 {
    let around = topology.neighbours.row(v);
    around.iter().map(|&n| vertices[n as usize]).sum::<Vec3>() / around.len().max(1) as f32
}

/// Where a naked head's landmarks lie in the T-pose.
struct Head {
    nose: Vec3,
    /// Left, right.
    ears: [Vec3; 2],
    /// A vertex of each ear.
    ear_vertices: [usize; 2],
}

impl Head {
    fn of(body: &Body, betas: &[f32]) -> Option<Self> {
        let set = body.keypoint_set("coco17")?;
        let shaped = body.shaped_vertices(betas);
        let place = |part, side| match set.points.get(index_of(&COCO17, (part, side))?)? {
            KeypointSource::Vertices(vertices) if !vertices.is_empty() => {
                let sum: Vec3 = vertices.iter().map(|&v| Vec3::from(shaped[v as usize])).sum();
                Some((sum / vertices.len() as f32, vertices[0] as usize))
            }
            _ => None,
        };
        let [nose, left, right] =
            [place(Part::Nose, Side::Middle)?, place(Part::Ear, Side::Left)?, place(Part::Ear, Side::Right)?];
        Some(Self { nose: nose.0, ears: [left.0, right.0], ear_vertices: [left.1, right.1] })
    }

    /// Distance between the ears.
    fn width(&self) -> f32 {
        self.ears[0].distance(self.ears[1])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::N_POSE;
    use crate::camera::Camera;
    use crate::capture::Frame;
    use crate::fit::stage0::Stage0Report;
    use crate::ops::skinning::cpu::forward;

    const SKIN: [u8; 3] = [200, 155, 130];
    const SIDE: u32 = 160;

    /// A body that turns once in eight frames before a camera with this focal length.
    fn turning(body: &Body, place: [f32; 3], focal: f64) -> Stage0Result {
        let pose = |k: usize| {
            let mut pose = [0.0; N_POSE];
            // Upright in a world whose y runs down, facing the camera first: half a turn about x, then the turn.
            let turn = glam::Quat::from_rotation_x(std::f32::consts::PI)
                * glam::Quat::from_rotation_y(std::f32::consts::TAU * k as f32 / 8.0);
            let root: [f32; 3] = turn.to_scaled_axis().into();
            pose[..3].copy_from_slice(&root);
            pose
        };
        Stage0Result {
            betas: vec![0.0; body.n_betas],
            poses: (0..8).map(pose).collect(),
            transl: vec![place; 8],
            camera: Camera::pinhole(SIDE, SIDE, [focal, focal, 80.0, 80.0]),
            keypoints: Vec::new(),
            report: Stage0Report::default(),
        }
    }

    /// Each vertex as a dot of its colour, the far ones first.
    fn filmed(body: &Body, start: &Stage0Result, colour: impl Fn(usize) -> [u8; 3]) -> Capture {
        let frame = |k: usize| {
            let n = (SIDE * SIDE) as usize;
            let (mut rgb, mut mask) = (vec![0; 3 * n], vec![0; n]);
            let posed = forward(body, &start.betas, None, &start.poses[k], start.transl[k]);
            let mut order: Vec<usize> = (0..body.n_vertices()).collect();
            order.sort_by(|&a, &b| posed.vertices[b][2].total_cmp(&posed.vertices[a][2]));
            for v in order {
                let at = start.camera.project(posed.vertices[v].map(f64::from)).map(|c| c as usize);
                for (dx, dy) in (0..9).map(|i| (i % 3, i / 3)) {
                    let pixel = (at[1] + dy - 1) * SIDE as usize + at[0] + dx - 1;
                    rgb[3 * pixel..][..3].copy_from_slice(&colour(v));
                    mask[pixel] = 255;
                }
            }
            let (width, height) = (SIDE, SIDE);
            Frame { index: k as u32, x0: 0, y0: 0, width, height, rgb, mask, keypoints: Vec::new() }
        };
        Capture {
            camera: start.camera.clone(),
            uploaded_side_px: 0,
            camera_estimated: false,
            fps: 30.0,
            frames: (0..8).map(frame).collect(),
            keypoint_format: "coco17".to_owned(),
            given_keypoint_format: "coco17".to_owned(),
            poses: None,
            warnings: Vec::new(),
        }
    }

    #[test]
    fn what_is_covered_is_told_by_its_colour() {
        let body = Body::test_body();
        let start = turning(&body, [0.0, 0.0, 3.0], 200.0);
        let of_feet = |v: usize| body.weight_of(v, |j| [7, 8, 10, 11].contains(&j)) > 0.5;
        let head = Head::of(&body, &start.betas).unwrap();
        let near_an_ear =
            |v: usize| head.ears.iter().any(|ear| ear.distance(body.v_template[v].into()) < 0.3 * head.width());
        let found = |colour: &dyn Fn(usize) -> [u8; 3]| Covered::find(&body, &filmed(&body, &start, colour), &start);
        assert_eq!(found(&|_| SKIN), Covered::default());
        let shoes = |v: usize| if of_feet(v) { [40, 40, 45] } else { SKIN };
        assert_eq!(found(&shoes), Covered { toes: true, ears: false });
        let hair = |v: usize| if near_an_ear(v) { [70, 50, 35] } else { SKIN };
        assert_eq!(found(&hair), Covered { toes: false, ears: true });
    }

    #[test]
    fn shoes_are_seen_by_a_camera_that_looks_down_on_them() {
        let body = Body::test_body();
        let low = body.v_template.iter().map(|v| v[1]).fold(f32::INFINITY, f32::min);
        // As high as it is away.
        let start = turning(&body, [0.0, 1.1 + low, 1.1], 60.0);
        let shoes =
            |v: usize| if body.weight_of(v, |j| [7, 8, 10, 11].contains(&j)) > 0.5 { [40, 40, 45] } else { SKIN };
        assert!(Covered::find(&body, &filmed(&body, &start, shoes), &start).toes);
    }

    #[test]
    fn only_toes_move_and_both_sides_alike() {
        let body = Body::test_body();
        let betas = vec![0.3; body.n_betas];
        let moved = |covered: Covered| {
            let mut even = body.clone();
            covered.even_out(&mut even, &betas);
            even.check().unwrap();
            let far = |v: usize| Vec3::from(even.v_template[v]).distance(body.v_template[v].into());
            let rows: Vec<(usize, f32)> = (0..body.n_vertices()).map(|v| (v, far(v))).filter(|m| m.1 > 1e-5).collect();
            for &(v, _) in &rows {
                let [left, right] = [v, body.mirror[v] as usize].map(|v| Vec3::from(even.v_template[v]));
                let apart = left.distance(right * Vec3::new(-1.0, 1.0, 1.0));
                assert!(apart < 5e-3, "vertex {v} and its mirror image lie {apart} m apart");
            }
            rows
        };
        assert!(moved(Covered::default()).is_empty());
        let toes = moved(Covered { toes: true, ears: false });
        assert!(!toes.is_empty());
        for (v, far) in toes {
            assert!(body.weight_of(v, |j| j == 10 || j == 11) > 0.0 && far < 0.05, "vertex {v} moved by {far} m");
        }
    }

    #[test]
    fn a_cap_has_no_gaps_and_is_as_long_as_the_toes() {
        let body = Body::test_body();
        let mut even = body.clone();
        // A deep fold across the toes of the left foot.
        let toes: Vec<usize> = (0..body.n_vertices()).filter(|&v| body.weight_of(v, |j| j == 10) > 0.9).collect();
        let middle = body.j_template[10][0];
        for &v in toes.iter().filter(|&&v| (body.v_template[v][0] - middle).abs() < 0.015) {
            even.v_template[v][2] -= 0.03;
        }
        let front = |body: &Body| toes.iter().map(|&v| body.v_template[v][2]).fold(f32::MIN, f32::max);
        let relief = |body: &Body| {
            let topology = Topology::new(body.n_vertices(), &body.faces);
            let vertices: Vec<Vec3> = body.v_template.iter().map(|&v| v.into()).collect();
            toes.iter().map(|&v| mean_around(&vertices, &topology, v).distance(vertices[v])).fold(0.0, f32::max)
        };
        let (folded, length) = (relief(&even), front(&even));
        Covered { toes: true, ears: false }.even_out(&mut even, &vec![0.0; body.n_betas]);
        assert!(relief(&even) < 0.6 * folded, "{} of {folded} m", relief(&even));
        assert!((front(&even) - length).abs() < 0.01, "{} instead of {length} m", front(&even));
    }
}
