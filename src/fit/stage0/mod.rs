//! Stage 0: body pose, shape and place of a person who turns in front of one camera, from 2D keypoints,
//! masks and what can be followed from frame to frame, on the CPU.
//!
//! One nonlinear least-squares problem over all frames: keypoints under a Geman–McClure loss (Bogo et al. 2016),
//! the mask's edge, points that pictures show over many frames (`tracks`), a standing prior with joint limits, and
//! smoothness that expects a steady turn (`problem`, `expectation`). Its normal equations are an arrow on a block
//! tridiagonal and are solved directly (`normal`).
//! Because the problem has many minima, it starts from a search over facings, directions of the turn and
//! swapped sides (`placement`), and frames are read anew between the rounds of descent (`sides`). Feet that step are looked
//! for too (`steps`), and hands and heads that do something else than hang and look ahead (`lively`).
//!
//! What one camera cannot tell: the absolute size. Scaling the body and its distance together leaves every image
//! as it was, so size comes from the shape prior.

mod contour;
mod expectation;
mod focal;
mod habits;
mod known;
mod landmarks;
mod lively;
mod minimise;
mod noise;
mod normal;
mod offsets;
mod placement;
mod prior;
mod problem;
mod report;
mod rig;
pub(super) mod rotation;
mod setup;
mod sides;
mod silhouette;
mod state;
mod steps;
#[cfg(test)]
mod synthetic;
#[cfg(test)]
mod tests;
mod tracks;
mod trust;

use crate::body::{Body, N_POSE};
use crate::camera::Camera;
use crate::capture::Capture;
pub use focal::{FOCAL_OFF, FocalCheck};
pub use known::COARSE_POSES;
use minimise::minimise;
pub use prior::ADULT_STATURE;
pub(super) use problem::geman_mcclure;
use problem::{Problem, Scales};
use state::State;
pub use trust::Trust;

/// What can be set. The defaults suit a clip of one turn.
#[derive(Clone, Debug)]
pub struct Stage0Options {
    /// Fit the outline to the masks after the keypoints.
    pub use_masks: bool,
    /// Follow points from picture to picture, where the capture has colours.
    pub use_pictures: bool,
    /// Most descent steps in one round.
    pub iterations: usize,
    /// The person's height in metres where somebody measured it: the one thing that a single camera cannot see.
    pub height_m: Option<f64>,
}

impl Default for Stage0Options {
    fn default() -> Self {
        Self { use_masks: true, use_pictures: true, iterations: 12, height_m: None }
    }
}

/// Body parameters of every frame, in the world of the capture's camera.
#[derive(Clone, Debug)]
pub struct Stage0Result {
    /// `[B]`; only the first 16 are fitted, others are zero.
    pub betas: Vec<f32>,
    /// `[N][72]`
    pub poses: Vec<[f32; N_POSE]>,
    /// `[N]`: SMPL's `transl`, metres; the pelvis joint ends at `J0(betas) + transl`.
    pub transl: Vec<[f32; 3]>,
    /// The capture's, with the focal length found where it was estimated.
    pub camera: Camera,
    /// `[N][K]`: the capture's detections as they were understood. Swapped sides are exchanged, each is moved by its
    /// part's fitted offset onto the body's own point, and disbelieved ones have no confidence.
    pub keypoints: Vec<Vec<[f32; 3]>>,
    pub report: Stage0Report,
}

/// How the fit went.
#[derive(Clone, Debug, Default)]
pub struct Stage0Report {
    /// `[N]`: root mean square distance of the kept keypoints, pixels; NaN where a frame has none.
    pub residual_px: Vec<f32>,
    /// The keypoints' noise as found, pixels.
    pub sigma_px: f32,
    /// Detections that the fit disbelieves: frame and keypoint, as given.
    pub dropped: Vec<(usize, usize)>,
    /// Frames of which some limbs or the face were read with sides swapped.
    pub swapped: Vec<usize>,
    /// Degrees from the first frame to the last; positive turns point the left side away first.
    pub turn_degrees: f32,
    /// The naked body's height where neither it nor poses were given, metres: what its proportions tell, held near
    /// [`ADULT_STATURE`].
    pub guessed_height_m: Option<f64>,
    /// What was found of poses that came with the clip.
    pub given_poses: Option<GivenPoses>,
    /// Points of the surface that were followed from frame to frame.
    pub tracked_points: usize,
    /// Mean overlap of the fitted outline with the masks, 0..1; 0 where masks were not used.
    pub mask_iou: f32,
    /// What people should know, one line each.
    pub notes: Vec<String>,
}

/// How well given poses fit the clip, and what became of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GivenPoses {
    /// By how much they are off in a frame besides what they are off by in all.
    pub off: Trust,
    /// Poses of the fit's own took their place.
    pub replaced: bool,
}

impl Stage0Report {
    /// What given poses are off by, where the fit keeps to them.
    pub fn kept_poses(&self) -> Option<Trust> {
        self.given_poses.filter(|given| !given.replaced).map(|given| given.off)
    }
}

impl Stage0Result {
    /// Replaces the capture's detections by those that were understood, for the stages that follow.
    pub fn reread(&self, capture: &mut Capture) {
        for (frame, keypoints) in capture.frames.iter_mut().zip(&self.keypoints) {
            frame.keypoints.clone_from(keypoints);
        }
    }
}

/// Why no poses were found: keypoints or known poses that are not of this form, or show nobody.
#[derive(Debug, thiserror::Error)]
pub enum Stage0Error {
    #[error("the clip has no frames")]
    NoFrames,
    #[error("keypoint format {0:?} is not known to body {1:?}; expected coco17, coco18 or body25")]
    UnknownFormat(String, String),
    #[error("frame {frame}: {found} keypoints, expected {expected}")]
    KeypointCount { frame: usize, found: usize, expected: usize },
    #[error(
        "no frame shows enough of a person who stands upright: at least a head or shoulder, and a leg below it (where a tag of \
         the video turns its images, masks and keypoints have to be turned too)"
    )]
    NobodyFound,
    #[error("poses: frame {frame}: {found} values, expected {N_POSE}")]
    PoseLength { frame: usize, found: usize },
    #[error("poses: {found} frames, expected {expected}")]
    PoseCount { found: usize, expected: usize },
    #[error("the fit diverged; the keypoints may not belong to this video")]
    Diverged,
    #[error("stopped")]
    Stopped,
}

/// A reading of the clip and its descent so far.
struct Candidate {
    problem: Problem,
    state: State,
    swapped: Vec<[bool; 3]>,
    /// Frame, landmark and weight of the points of faces that are taken for unseen.
    hidden: Vec<(usize, usize, f64)>,
    scales: Scales,
    cost: f64,
}

/// Fits the clip. `progress` hears fractions of the work done and answers whether to go on.
///
/// # Errors
/// See [`Stage0Error`]; `Stopped` where `progress` said so.
pub fn solve(
    body: &Body,
    capture: &Capture,
    options: &Stage0Options,
    progress: &mut dyn FnMut(f32) -> bool,
) -> Result<Stage0Result, Stage0Error> {
    let mut report = Stage0Report::default();
    let rounds = offsets::ROUNDS
        + LASTING_ROUNDS
        + if options.use_pictures { tracks::rounds(capture) } else { 0 }
        + if options.use_masks { contour::MOST_ROUNDS } else { 0 };
    let mut progress = RoundProgress::new(progress, rounds, options.iterations.max(1));
    let read = |mut candidates: Vec<Candidate>, height: Option<f64>, progress: &mut RoundProgress<'_>| {
        if let Some(height) = options.height_m.or(height) {
            candidates.iter_mut().for_each(|c| c.problem.stature.measured(height));
        }
        read(candidates, progress)
    };
    let mut best = match &capture.poses {
        None => read(setup::candidates(body, capture)?, None, &mut progress)?,
        Some(known) => {
            let given = read(vec![known::candidate(body, capture, known, &mut report)?], None, &mut progress)?;
            let mut own = |height| read(setup::candidates(body, capture)?, height, &mut progress);
            let (best, poses) = known::kept_or_replaced(given, &mut own)?;
            if poses.is_some_and(|poses| poses.replaced) {
                report.notes.clear();
            }
            report.given_poses = poses;
            best
        }
    };
    offsets::settle(&mut best, &mut progress)?;
    best.bear_lasting_noise(&mut progress)?;
    if options.use_masks {
        contour::refine(&mut best, body, capture, &mut report, &mut progress)?;
    }
    if options.use_pictures {
        report.tracked_points = tracks::refine(&mut best, body, capture, &mut progress)?;
    }
    if !best.cost.is_finite() {
        return Err(Stage0Error::Diverged);
    }
    Ok(report::result(&best, body, capture, report))
}

/// Descends from all candidates with wide scales, and from the likeliest one until the noise is settled.
fn read(mut candidates: Vec<Candidate>, progress: &mut RoundProgress<'_>) -> Result<Candidate, Stage0Error> {
    progress.rounds += ROUGH_ROUNDS * candidates.len() + FINE_ROUNDS;
    for candidate in &mut candidates {
        for round in 0..ROUGH_ROUNDS {
            if round > 0 {
                candidate.tighten(ROUGH_RHO);
            }
            candidate.descend(1e-3, progress)?;
        }
    }
    let mut best = likeliest(candidates).ok_or(Stage0Error::NobodyFound)?;
    // Only now: a reading that faces the wrong way must not be rid of the face that contradicts it.
    best.hidden = sides::ignore_hidden_faces(&mut best.problem, &best.state);
    for _ in 0..FINE_ROUNDS {
        best.tighten(FINE_RHO);
        best.look_for_life();
        best.learn_trust();
        best.descend(1e-4, progress)?;
    }
    Ok(best)
}

/// The candidate of least cost, all measured with the finest noise that one of them reached: a bad reading would
/// hide behind a noise of its own.
fn likeliest(mut candidates: Vec<Candidate>) -> Option<Candidate> {
    let finest = candidates.iter().map(|c| c.scales.sigma_px).min_by(f64::total_cmp)?;
    for candidate in &mut candidates {
        let scales = Scales { sigma_px: finest, rho: ROUGH_RHO, ..candidate.scales };
        candidate.cost = candidate.problem.evaluate(&candidate.state, &scales, None);
    }
    candidates.into_iter().min_by(|a, b| a.cost.total_cmp(&b.cost))
}

/// Rounds with wide scales, to tell the readings apart, and rounds that settle the noise.
const ROUGH_ROUNDS: usize = 2;
const FINE_ROUNDS: usize = 3;
const LASTING_ROUNDS: usize = 1;
const ROUGH_RHO: f64 = 4.0;
const FINE_RHO: f64 = 3.0;

impl Candidate {
    /// Looks for arms and heads that do not only hang and look ahead. Given poses know.
    fn look_for_life(&mut self) {
        if self.problem.given.is_some() {
            return;
        }
        self.hidden.drain(..).for_each(|(t, k, weight)| self.problem.observations[t][k].weight = weight);
        self.problem.lively = lively::find(&self.problem, &mut self.state, &self.scales);
        self.hidden = sides::ignore_hidden_faces(&mut self.problem, &self.state);
    }

    /// Learns how far given poses are off.
    fn learn_trust(&mut self) {
        if let Some(mut given) = self.problem.given.take() {
            given.learn(&self.problem, &self.state, &self.scales);
            self.problem.given = Some(given);
        }
    }

    /// Reads sides anew and sets the scales to the residuals' own.
    fn tighten(&mut self, rho: f64) {
        if self.problem.given.is_none() {
            sides::reread(&mut self.problem, &self.state, &self.scales, &mut self.swapped);
        }
        self.scales.sigma_px = noise::of_each_frame(&self.problem, &self.state, &self.scales);
        self.scales.rho = rho;
    }

    /// Trusts detections less whose errors last, and expects people to sway about a stance: most of all where the clip begins and
    /// ends, such errors look like a lean. Before masks and pictures are looked at, which then tell the more; given poses
    /// are held to anyway.
    fn bear_lasting_noise(&mut self, progress: &mut RoundProgress) -> Result<(), Stage0Error> {
        let lasting = noise::lasting(&self.problem, &self.state);
        if self.problem.given.is_some() || lasting <= self.scales.sigma_px {
            progress.round += LASTING_ROUNDS;
            return Ok(());
        }
        self.scales.sigma_px = lasting;
        self.problem.stance = Some(self.problem.stance_of(&self.state));
        self.descend(1e-4, progress)
    }

    fn descend(&mut self, tolerance: f64, progress: &mut RoundProgress) -> Result<(), Stage0Error> {
        if self.problem.stance.is_some() {
            self.problem.stance = Some(self.problem.stance_of(&self.state));
        }
        let iterations = progress.iterations;
        let mut go_on = || progress.tick();
        let descent = minimise(&self.problem, self.state.clone(), &self.scales, iterations, tolerance, &mut go_on);
        (self.state, self.cost) = (descent.state, descent.cost);
        progress.round += 1;
        progress.step = 0;
        if descent.finished { Ok(()) } else { Err(Stage0Error::Stopped) }
    }
}

/// Tells how far the work is, and hears whether to go on.
struct RoundProgress<'a> {
    tell: &'a mut dyn FnMut(f32) -> bool,
    /// As far as they are known.
    rounds: usize,
    /// What was told last.
    told: f32,
    /// At most, a round.
    iterations: usize,
    round: usize,
    step: usize,
}

impl<'a> RoundProgress<'a> {
    fn new(tell: &'a mut dyn FnMut(f32) -> bool, rounds: usize, iterations: usize) -> Self {
        Self { tell, rounds, told: 0.0, iterations, round: 0, step: 0 }
    }

    fn tick(&mut self) -> bool {
        self.step += 1;
        self.goes_on()
    }

    fn goes_on(&mut self) -> bool {
        let rounds = self.round as f32 + self.step as f32 / self.iterations as f32;
        // More may have become known.
        self.told = self.told.max(rounds / self.rounds as f32);
        (self.tell)(self.told)
    }
}
