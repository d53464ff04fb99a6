//! The mask's edge as evidence: points of the model's outline are drawn along the mask's distance field.

use std::collections::HashMap;

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::prior;
use super::problem::{ContourPoint, Pinhole, Problem};
use super::rig::{Point, Posed};
use super::silhouette::{Field, Grid, fill};
use super::state::{self, State};
use super::steps::Looks;
use super::{Candidate, RoundProgress, Stage0Error, Stage0Report};
use crate::body::Body;
use crate::body::joints::{
    HEAD, LEFT_ANKLE, LEFT_FOOT, LEFT_HAND, LEFT_HIP, LEFT_WRIST, PELVIS, RIGHT_ANKLE, RIGHT_FOOT, RIGHT_HAND,
    RIGHT_HIP, RIGHT_WRIST,
};
use crate::capture::{Capture, Frame};
use crate::mask::is_foreground;

/// Times that outlines are matched anew: before steps are looked for, and again where there are some.
const ROUNDS: usize = 3;
pub const MOST_ROUNDS: usize = 2 * ROUNDS;
/// Points of the outline in a frame.
const POINTS: usize = 160;
/// Information of one point: neighbours say nearly the same.
const WEIGHT: f64 = 0.05;
/// Clothes are the same in all frames: so many frames weigh as much for the shape as one.
const FRAMES_ALIKE: f64 = 50.0;
/// The same up and down: shoes and hair make everybody taller, but not everybody wider.
const FRAMES_ALIKE_IN_HEIGHT: f64 = 10.0;
/// σ of the naked body's outline outside the mask, where it hardly is, of the person's height.
const OUTSIDE: f64 = 0.006;
/// The same inside, by the thickness of clothes.
const INSIDE: f64 = 0.012;
/// The least cosine between the normals of two outlines that are the same.
const ALIKE: f64 = 0.6;
/// How far from the mask's edge an outline is still the same, of the person's height.
const REACH: f64 = 0.06;
/// Ankles and toes, head, wrists and hands: shoes and hair are always larger than what they cover.
const DRESSED_JOINTS: [usize; 9] =
    [LEFT_ANKLE, RIGHT_ANKLE, LEFT_FOOT, RIGHT_FOOT, HEAD, LEFT_WRIST, RIGHT_WRIST, LEFT_HAND, RIGHT_HAND];
/// Distance from the picture's border in pixels where masks end without being a person's edge.
const BORDER_PX: f64 = 3.0;

/// Fits the outline after the keypoints have settled.
pub fn refine(
    best: &mut Candidate,
    body: &Body,
    capture: &Capture,
    report: &mut Stage0Report,
    progress: &mut RoundProgress,
) -> Result<(), Stage0Error> {
    let masks: Vec<Option<Field>> = capture.frames.par_iter().map(mask_field).collect();
    let found = masks.iter().flatten().count();
    if found == 0 {
        report.notes.push("masks: no frame has an edge to fit".to_owned());
        return Ok(());
    }
    let height = best.problem.height_px(&best.state);
    // Where detectors see a joint is settled by then. Clothes hang lower than the body: could they talk keypoints out of where
    // the hips are, hips would follow the crotch of the trousers.
    best.problem.offsets = best.state.shared.offsets;
    best.problem.offset_sigma = best.problem.offset_sigma.map(|sigma| sigma.min(prior::SETTLED_OFFSET_SIGMA));
    best.scales.contour_weight = WEIGHT;
    let frames = best.state.frames.len() as f64;
    best.scales.shape_weight = (frames / FRAMES_ALIKE).max(1.0);
    best.scales.stature_weight = (frames / FRAMES_ALIKE_IN_HEIGHT).max(1.0);
    best.scales.contour_outside_px = OUTSIDE * height;
    best.scales.contour_inside_px = INSIDE * height;
    let dressed: Vec<bool> = (0..body.n_vertices()).map(|v| is_dressed(body, v)).collect();
    let outline = |state: &State| Outline {
        body,
        dressed: &dressed,
        shaped: shaped(body, state),
        size: DVec2::new(f64::from(capture.camera.width), f64::from(capture.camera.height)),
        reach_px: REACH * height,
    };
    let mut known = HashMap::new();
    for _ in 0..ROUNDS {
        outline(&best.state).attach(&mut best.problem, &best.state, &masks, &mut known);
        best.descend(1e-3, progress)?;
    }
    if best.problem.given.is_none() && find_steps(best, &outline(&best.state), capture, &masks) {
        for _ in 0..ROUNDS {
            outline(&best.state).attach(&mut best.problem, &best.state, &masks, &mut known);
            best.descend(1e-3, progress)?;
        }
    } else {
        progress.round += ROUNDS;
        if !progress.goes_on() {
            return Err(Stage0Error::Stopped);
        }
    }
    report.mask_iou = outline(&best.state).overlap(&best.problem, &best.state, capture, &masks) as f32;
    Ok(())
}

/// Looks for steps, and puts them into the state. False where nobody steps.
fn find_steps(best: &mut Candidate, outline: &Outline<'_>, capture: &Capture, masks: &[Option<Field>]) -> bool {
    let Candidate { problem, state, scales, .. } = &*best;
    let height = problem.height_px(state);
    let camera = problem.camera.zoomed(state.shared.log_focal);
    let pairs = masks.par_iter().zip(&capture.frames);
    let cells: Vec<_> = pairs.map(|(mask, seen)| Some(mask_cells(seen, &mask.as_ref()?.grid))).collect();
    let differs = |t: usize, frame: &state::Frame| {
        let (grid, cells) = (&masks[t].as_ref()?.grid, cells[t].as_ref()?);
        let model = outline.filled(&problem.rig.pose(frame, &state.shared), &camera, grid);
        let different = model.iter().zip(cells).filter(|(a, b)| a != b).count();
        Some(different as f64 * (grid.step / height).powi(2))
    };
    let (steps, frames) = Looks { problem, state, scales, differs: &differs }.find();
    let found = !steps.lifted.is_empty();
    (best.problem.steps, best.state.frames) = (steps, frames);
    found
}

/// The mask as it is stored, thinned to a grid: cells round the crop are outside.
fn mask_cells(frame: &Frame, grid: &Grid) -> Vec<bool> {
    let mut inside = vec![false; grid.width * grid.height];
    for row in 0..grid.height {
        for column in 0..grid.width {
            let at = grid.centre(column, row) - DVec2::new(f64::from(frame.x0), f64::from(frame.y0));
            if at.x >= 0.0 && at.y >= 0.0 && at.x < f64::from(frame.width) && at.y < f64::from(frame.height) {
                let pixel = at.y as usize * frame.width as usize + at.x as usize;
                inside[row * grid.width + column] = frame.mask.get(pixel).is_some_and(|m| is_foreground(*m));
            }
        }
    }
    inside
}

fn mask_field(frame: &Frame) -> Option<Field> {
    let grid = Grid::around(frame.x0, frame.y0, frame.width, frame.height);
    Field::new(grid, &mask_cells(frame, &grid))
}

pub(super) fn shaped(body: &Body, state: &State) -> Vec<DVec3> {
    let betas: Vec<f32> = state.shared.betas.iter().map(|b| *b as f32).collect();
    let double = |v: [f32; 3]| DVec3::from_array(v.map(f64::from));
    body.shaped_vertices(&betas).into_iter().map(double).collect()
}

/// Whether clothes and hair hide where a vertex is: no outline is taken from it. Trousers and skirts hang below the crotch:
/// taken for the body's own, their outline pulled hips and pelvis down by more than a centimetre.
fn is_dressed(body: &Body, v: usize) -> bool {
    is_covered(body, v) || is_between_the_legs(body, v)
}

fn is_between_the_legs(body: &Body, v: usize) -> bool {
    let ([x, y, _], hip) = (body.v_template[v], body.j_template[LEFT_HIP]);
    let of_hips = body.weight_of(v, |joint| [PELVIS, LEFT_HIP, RIGHT_HIP].contains(&(joint as usize)));
    of_hips > 0.5 && x.abs() < hip[0].abs() && y < hip[1]
}

fn is_covered(body: &Body, v: usize) -> bool {
    body.weight_of(v, |joint| DRESSED_JOINTS.contains(&(joint as usize))) > 0.3
}

/// The model's outline in all frames of one state.
struct Outline<'a> {
    body: &'a Body,
    shaped: Vec<DVec3>,
    /// `[V]`: vertices under hair and shoes, between the legs, or of hands, whose joints are not fitted.
    dressed: &'a [bool],
    /// Of the picture, pixels.
    size: DVec2,
    reach_px: f64,
}

impl Outline<'_> {
    /// Renews the problem's contours. `known`: the surface points that the problem already holds.
    fn attach(&self, problem: &mut Problem, state: &State, masks: &[Option<Field>], known: &mut HashMap<usize, usize>) {
        let camera = problem.camera.zoomed(state.shared.log_focal);
        let rig = &problem.rig;
        let of_frame = |(frame, mask): (&state::Frame, &Option<Field>)| {
            let posed = rig.pose(frame, &state.shared);
            mask.as_ref().map_or_else(Vec::new, |mask| self.points(&posed, &camera, mask))
        };
        let mut contours: Vec<Vec<ContourPoint>> = state.frames.par_iter().zip(masks).map(of_frame).collect();
        for point in contours.iter_mut().flatten() {
            let vertex = point.vertex;
            point.vertex = *known.entry(vertex).or_insert_with(|| {
                problem.surface.push(Point::vertex(self.body, vertex));
                problem.surface.len() - 1
            });
        }
        problem.contours = contours;
    }

    /// Every vertex in camera space.
    fn posed_vertices(&self, posed: &Posed) -> Vec<DVec3> {
        posed.vertices(self.body, &self.shaped)
    }

    /// The cells that the body covers.
    fn filled(&self, posed: &Posed, camera: &Pinhole, grid: &Grid) -> Vec<bool> {
        let image: Vec<DVec2> = self.posed_vertices(posed).into_iter().map(|p| camera.project(p)).collect();
        fill(grid, &image, &self.body.faces)
    }

    /// Vertices of the outline (`vertex`: the body's) and their places on the mask's edge.
    fn points(&self, posed: &Posed, camera: &Pinhole, mask: &Field) -> Vec<ContourPoint> {
        let image: Vec<DVec2> = self.posed_vertices(posed).into_iter().map(|p| camera.project(p)).collect();
        let Some(model) = Field::new(mask.grid, &fill(&mask.grid, &image, &self.body.faces)) else {
            return Vec::new();
        };
        let mut candidates = Vec::new();
        for vertex in rim(&image, &self.body.faces) {
            if self.dressed[vertex] {
                continue;
            }
            let at = image[vertex];
            let border = at.min(self.size - at).min_element();
            let Some((depth, outward)) = model.slope(at).filter(|_| border > BORDER_PX) else { continue };
            if depth.abs() > 1.5 * mask.grid.step {
                continue;
            }
            let Some((distance, normal)) = mask.slope(at) else { continue };
            if normal.dot(outward) > ALIKE && distance.abs() < self.reach_px {
                candidates.push(ContourPoint { vertex, at: at - normal * distance, normal });
            }
        }
        let every = candidates.len().div_ceil(POINTS).max(1);
        candidates.into_iter().step_by(every).collect()
    }

    /// Mean intersection over union with the masks.
    fn overlap(&self, problem: &Problem, state: &State, capture: &Capture, masks: &[Option<Field>]) -> f64 {
        let camera = problem.camera.zoomed(state.shared.log_focal);
        let of_frame = |((frame, mask), seen): ((&state::Frame, &Option<Field>), &Frame)| {
            let mask = mask.as_ref()?;
            let posed = problem.rig.pose(frame, &state.shared);
            let model = self.filled(&posed, &camera, &mask.grid);
            let seen = mask_cells(seen, &mask.grid);
            let pairs = || model.iter().zip(&seen);
            let both = pairs().filter(|(a, b)| **a && **b).count();
            let any = pairs().filter(|(a, b)| **a || **b).count();
            Some(both as f64 / any.max(1) as f64)
        };
        let all: Vec<Option<f64>> = state.frames.par_iter().zip(masks).zip(&capture.frames).map(of_frame).collect();
        let count = all.iter().flatten().count();
        all.iter().flatten().sum::<f64>() / count.max(1) as f64
    }
}

/// Vertices between faces that look at us and faces that look away, ascending.
fn rim(image: &[DVec2], faces: &[[u32; 3]]) -> Vec<usize> {
    let mut sides = vec![0u8; image.len()];
    for face in faces {
        let [a, b, c] = face.map(|v| image[v as usize]);
        let side = if (b - a).perp_dot(c - a) > 0.0 { 1 } else { 2 };
        face.iter().for_each(|v| sides[*v as usize] |= side);
    }
    (0..image.len()).filter(|v| sides[*v] == 3).collect()
}
