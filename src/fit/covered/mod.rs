//! Toes in shoes and ears under hair. Offsets are smooth, so a naked body's toes and ears would show through whatever covers
//! them, as a relief that no picture has. None of it is in the paper. Here the clip's colours tell what is covered, and the body's
//! template loses that relief: feet end in a cap, the head's side goes on over the ear.

mod ear_patch;
mod seen;
mod toe_cap;

use glam::Vec3;

use crate::body::{Body, KeypointSource};
use crate::capture::Capture;
use crate::fit::stage0::Stage0Result;

/// Ankle and foot: left, right.
const FEET: [[usize; 2]; 2] = [[7, 10], [8, 11]];
/// Part of a vertex' weight from which on it belongs to the toes.
const OF_TOES: f32 = 0.5;
/// Nose, left and right ear among COCO's 17 points.
const NOSE: usize = 0;
const EARS: [usize; 2] = [3, 4];

/// What of a body something covers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
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
        if self.toes {
            let joints = body.shaped_joints(betas);
            for [ankle, foot] in FEET {
                toe_cap::cap(&mut even, body, [ankle, foot], [joints[ankle].into(), joints[foot].into()]);
            }
        }
        if let Some(head) = Head::of(body, betas).filter(|_| self.ears) {
            for side in 0..2 {
                ear_patch::patch(&mut even, body, head.ear_vertices[side], head.ears[1 - side]);
            }
        }
        for (template, (even, shaped)) in body.v_template.iter_mut().zip(even.iter().zip(&shaped)) {
            *template = (Vec3::from(*template) + *even - *shaped).into();
        }
    }
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
        let place = |point: usize| match set.points.get(point)? {
            KeypointSource::Vertices(vertices) if !vertices.is_empty() => {
                let sum: Vec3 = vertices.iter().map(|&v| Vec3::from(shaped[v as usize])).sum();
                Some((sum / vertices.len() as f32, vertices[0] as usize))
            }
            _ => None,
        };
        let [nose, left, right] = [place(NOSE)?, place(EARS[0])?, place(EARS[1])?];
        Some(Self { nose: nose.0, ears: [left.0, right.0], ear_vertices: [left.1, right.1] })
    }

    /// Distance between the ears.
    fn width(&self) -> f32 {
        self.ears[0].distance(self.ears[1])
    }
}
