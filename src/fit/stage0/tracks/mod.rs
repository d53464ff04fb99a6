//! Points of the person's surface that pictures show over many frames, as evidence: what a detector says of a joint is off by
//! pixels in each frame, a print or a seam is found again to a fraction of one. Where such a point lies on the body is unknown
//! and solved for together with poses and shape (bundle adjustment; Triggs et al. 2000).

mod flow;
mod picture;
mod search;
#[cfg(test)]
mod tests;

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::noise::MEDIAN_DISTANCE;
use super::rig::{Point, Posed};
use super::state::State;
use super::{Candidate, RoundProgress, Stage0Error, contour};
use crate::body::Body;
use crate::body::joints::{LEFT_FOOT, LEFT_HAND, LEFT_WRIST, RIGHT_FOOT, RIGHT_HAND, RIGHT_WRIST};
use crate::capture::Capture;
use crate::math::median;
use search::Track;

/// Rounds of descent.
const ROUNDS: usize = 2;
/// Geman–McClure's ρ in multiples of σ: cloth slides, and patches at an edge slide along it.
pub const RHO: f64 = 2.0;
/// Information of one sighting: errors of neighbouring frames are alike.
pub const WEIGHT: f64 = 0.3;
/// How far clothes and hair lift a point off the body, over the person's height.
pub const OFFSET_SIGMA: f64 = 0.018;
/// Points at most: each adds three unknowns that all frames share.
const POINTS: usize = 128;
/// Points are not taken where a better one lies this near, over the person's height, within this part of the clip.
const APART: f64 = 0.04;
const APART_IN_TIME: f64 = 0.08;
/// Bounds of σ over the person's height.
const LEAST_NOISE: f64 = 0.002;
const MOST_NOISE: f64 = 0.008;
/// Cosine between a surface and the line of sight below which a patch is too oblique to be followed.
const OBLIQUE: f64 = 0.35;
/// How far from a vertex a point may lie, over the person's height.
const REACH: f64 = 0.04;
/// Surfaces this much behind the nearest are hidden by it, metres.
const BEHIND: f64 = 0.08;
/// Wrists, hands and toes are not posed here.
const STIFF_JOINTS: [usize; 6] = [LEFT_FOOT, RIGHT_FOOT, LEFT_WRIST, RIGHT_WRIST, LEFT_HAND, RIGHT_HAND];

/// A point as one frame shows it.
pub struct Sighting {
    pub point: usize,
    pub at: DVec2,
}

/// Points on the body and where they were seen.
#[derive(Default)]
pub struct Tracks {
    pub points: Vec<Point>,
    /// `[P]`: the displacement from the vertex in the zero pose that the frame in which it was met says, over the person's height.
    pub expected: Vec<DVec3>,
    /// `[N]`
    pub sightings: Vec<Vec<Sighting>>,
}

/// Rounds of descent that a clip takes.
pub fn rounds(capture: &Capture) -> usize {
    if search::shows_pictures(capture) { ROUNDS } else { 0 }
}

/// Finds points, attaches them to the body as it stands, and descends with them. How many there are.
pub fn refine(
    best: &mut Candidate,
    body: &Body,
    capture: &Capture,
    progress: &mut RoundProgress<'_>,
) -> Result<usize, Stage0Error> {
    let height = best.problem.height_px(&best.state);
    let tracks = search::find(capture, height, || progress.goes_on()).ok_or(Stage0Error::Stopped)?;
    let attached = attach(best, body, &tracks, height);
    let found = attached.points.len();
    if found == 0 {
        return Ok(0);
    }
    best.problem.layout.track(found);
    let stature = best.problem.stature.of(&best.state.shared.betas);
    best.state.shared.tracked = attached.expected.iter().map(|expected| *expected * stature).collect();
    best.problem.tracks = attached;
    for _ in 0..ROUNDS {
        best.scales.track_px = noise(best, height);
        best.descend(1e-4, progress)?;
    }
    Ok(found)
}

/// σ of one coordinate from the median distance, as [`super::noise::of_each_frame`] has it for keypoints, without its factor.
fn noise(best: &Candidate, height: f64) -> f64 {
    let Candidate { problem, state, .. } = best;
    let camera = problem.camera.zoomed(state.shared.log_focal);
    let mut all = Vec::new();
    for (frame, sightings) in state.frames.iter().zip(&problem.tracks.sightings) {
        let posed = problem.rig.pose(frame, &state.shared);
        for Sighting { point, at } in sightings {
            let added = state.shared.tracked[*point];
            let place = posed.place(&problem.tracks.points[*point], &state.shared.betas, added);
            all.push(camera.project(place).distance(*at));
        }
    }
    (median(all).unwrap_or(0.0) / MEDIAN_DISTANCE).clamp(LEAST_NOISE * height, MOST_NOISE * height)
}

/// The surface of one frame.
struct Surface {
    places: Vec<DVec3>,
    image: Vec<DVec2>,
    /// Cosine between the outward normal and the line to the camera.
    towards: Vec<f64>,
}

impl Surface {
    fn new(body: &Body, shaped: &[DVec3], posed: &Posed, project: impl Fn(DVec3) -> DVec2) -> Self {
        let places = posed.vertices(body, shaped);
        let mut normals = vec![DVec3::ZERO; places.len()];
        for face in &body.faces {
            let [a, b, c] = face.map(|v| places[v as usize]);
            let normal = (b - a).cross(c - a);
            face.iter().for_each(|v| normals[*v as usize] += normal);
        }
        let towards = |(p, n): (&DVec3, &DVec3)| -p.normalize_or_zero().dot(n.normalize_or_zero());
        Self {
            image: places.iter().map(|p| project(*p)).collect(),
            towards: places.iter().zip(&normals).map(towards).collect(),
            places,
        }
    }

    /// The visible vertex nearest to a pixel.
    fn vertex_at(&self, at: DVec2, reach: f64) -> Option<usize> {
        let near =
            || (0..self.places.len()).filter(|v| self.image[*v].distance(at) < reach && self.towards[*v] > OBLIQUE);
        let front = near().map(|v| self.places[v].z).fold(f64::INFINITY, f64::min);
        near()
            .filter(|v| self.places[*v].z < front + BEHIND)
            .min_by(|a, b| self.image[*a].distance(at).total_cmp(&self.image[*b].distance(at)))
    }
}

fn is_stiff(body: &Body, v: usize) -> bool {
    body.weight_of(v, |joint| STIFF_JOINTS.contains(&(joint as usize))) > 0.3
}

/// Ties tracks to the vertices that they are seen at in the middle of their time.
fn attach(best: &Candidate, body: &Body, tracks: &[Track], height: f64) -> Tracks {
    let Candidate { problem, state, .. } = best;
    let n = state.frames.len();
    let camera = problem.camera.zoomed(state.shared.log_focal);
    let shaped = contour::shaped(body, state);
    let stature = problem.stature.of(&state.shared.betas);
    let posed: Vec<Posed> = state.frames.iter().map(|frame| problem.rig.pose(frame, &state.shared)).collect();
    let surfaces: Vec<Surface> =
        posed.par_iter().map(|posed| Surface::new(body, &shaped, posed, |p| camera.project(p))).collect();
    let mut taken: Vec<(usize, DVec2)> = Vec::new();
    let mut chosen = Vec::new();
    for track in tracks {
        if chosen.len() == POINTS {
            break;
        }
        let half = track.places.len() / 2;
        let (middle, at) = (track.first + half, track.places[half]);
        let near_in_time = (APART_IN_TIME * n as f64).max(1.0) as usize;
        if taken.iter().any(|(t, p)| t.abs_diff(middle) <= near_in_time && p.distance(at) < APART * height) {
            continue;
        }
        let Some(vertex) = surfaces[middle].vertex_at(at, REACH * height).filter(|v| !is_stiff(body, *v)) else {
            continue;
        };
        let seen: Vec<(usize, DVec2)> = track
            .places
            .iter()
            .enumerate()
            .map(|(k, at)| (track.first + k, *at))
            .filter(|(t, _)| surfaces[*t].towards[vertex] > OBLIQUE)
            .collect();
        if seen.len() < search::LEAST_FRAMES {
            continue;
        }
        let place = surfaces[middle].places[vertex];
        let point = Point::vertex(body, vertex);
        let expected = unposed(&posed[middle], &point, state, camera.ray(at) * place.z) / stature;
        chosen.push((point, expected, seen));
        taken.push((middle, at));
    }
    // In the order in which they are first seen the normal equations' border fills from the left.
    chosen.sort_by_key(|(.., seen)| seen[0].0);
    let mut found = Tracks { sightings: (0..n).map(|_| Vec::new()).collect(), ..Tracks::default() };
    for (point, expected, seen) in chosen {
        for (t, at) in seen {
            found.sightings[t].push(Sighting { point: found.points.len(), at });
        }
        found.points.push(point);
        found.expected.push(expected);
    }
    found
}

/// The displacement in the zero pose that takes a point to `place`.
fn unposed(posed: &Posed, point: &Point, state: &State, place: DVec3) -> DVec3 {
    let with = |added: DVec3| posed.place(point, &state.shared.betas, added);
    let bare = with(DVec3::ZERO);
    let turned = glam::DMat3::from_cols(with(DVec3::X) - bare, with(DVec3::Y) - bare, with(DVec3::Z) - bare);
    turned.inverse() * (place - bare)
}
