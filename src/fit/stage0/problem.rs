//! The evidence's residuals, keypoints and contours, and their share of the normal equations.

use glam::{DVec2, DVec3};

use super::landmarks::{Landmark, N_OFFSETS};
use super::lively::Lively;
use super::normal::Normal;
use super::prior::{self, Prior};
use super::rig::{Point, PointJacobian, Posed, Rig};
use super::state::{Frame, Layout, Shared, State};
use super::steps::Steps;
use super::tracks::{self, Tracks};
use super::trust::Given;
use crate::body::N_JOINTS;
use crate::camera::Camera;

/// A pinhole without distortion, the person in camera space. It has [`Camera::project`]'s arithmetic for itself: what lies behind
/// the camera must have a place on the picture too, and [`Pinhole::slopes`] are that place's derivatives.
#[derive(Clone, Copy, Debug)]
pub struct Pinhole {
    pub fx: f64,
    pub fy: f64,
    pub cx: f64,
    pub cy: f64,
}

/// Nearest depth that still counts as in front, metres.
pub const NEAR: f64 = 0.05;

/// A nominal height, metres, whoever is filmed: what is told in parts of the height in pixels needs no more than its size.
const NOMINAL_HEIGHT_M: f64 = 1.7;

impl Pinhole {
    pub fn of(camera: &Camera) -> Self {
        Self { fx: camera.fx, fy: camera.fy, cx: camera.cx, cy: camera.cy }
    }

    pub fn zoomed(&self, log_focal: f64) -> Self {
        let zoom = log_focal.exp();
        Self { fx: self.fx * zoom, fy: self.fy * zoom, ..*self }
    }

    pub fn project(&self, p: DVec3) -> DVec2 {
        let z = p.z.max(NEAR);
        DVec2::new(self.fx * p.x / z + self.cx, self.fy * p.y / z + self.cy)
    }

    /// The place at depth 1 that is seen at a pixel.
    pub fn ray(&self, at: DVec2) -> DVec3 {
        DVec3::new((at.x - self.cx) / self.fx, (at.y - self.cy) / self.fy, 1.0)
    }

    /// Gradients of u and v.
    pub fn slopes(&self, p: DVec3) -> [DVec3; 2] {
        let z = p.z.max(NEAR);
        [DVec3::new(self.fx / z, 0.0, -self.fx * p.x / (z * z)), DVec3::new(0.0, self.fy / z, -self.fy * p.y / (z * z))]
    }
}

/// One detection; weight 0 = not seen.
#[derive(Clone, Copy, Debug)]
pub struct Observation {
    pub at: DVec2,
    pub weight: f64,
}

/// A point of the model's outline and the mask's edge it should lie on.
pub struct ContourPoint {
    /// Index into [`Problem::surface`].
    pub vertex: usize,
    pub at: DVec2,
    /// Out of the mask, unit length.
    pub normal: DVec2,
}

/// How sure the image is, in pixels, and from where residuals stop to count.
#[derive(Clone, Copy, Debug)]
pub struct Scales {
    pub sigma_px: f64,
    /// Geman–McClure's ρ in multiples of σ.
    pub rho: f64,
    /// Information of one contour point; 0 switches contours off.
    pub contour_weight: f64,
    /// σ of contours outside and inside the mask: clothes and hair make masks larger than the naked body.
    pub contour_outside_px: f64,
    pub contour_inside_px: f64,
    /// σ of a tracked point.
    pub track_px: f64,
    /// Information of the priors of shape and stature: more than 1 where the evidence errs alike in all frames.
    pub shape_weight: f64,
    pub stature_weight: f64,
}

/// The body's height, metres.
pub struct Stature {
    pub template: f64,
    /// For a unit of each beta. `[B]`
    pub slopes: Vec<f64>,
    pub expected: f64,
    pub sigma: f64,
}

impl Stature {
    /// Metres.
    pub fn of(&self, betas: &[f64]) -> f64 {
        self.template + self.slopes.iter().zip(betas).map(|(s, b)| s * b).sum::<f64>()
    }

    /// Somebody measured the person.
    pub fn measured(&mut self, height: f64) {
        (self.expected, self.sigma) = (height, prior::MEASURED_SIGMA);
    }

    pub fn is_measured(&self) -> bool {
        self.sigma == prior::MEASURED_SIGMA
    }
}

/// The mean over a clip's frames.
pub struct Stance {
    /// The camera's up axis as the body's root sees it.
    pub up: DVec3,
    pub theta: [DVec3; N_JOINTS],
    /// How far each joint sways about it, radians.
    pub sway: [f64; N_JOINTS],
}

pub struct Problem {
    pub rig: Rig,
    pub layout: Layout,
    pub prior: Prior,
    pub camera: Pinhole,
    pub stature: Stature,
    /// Spread of the focal length's logarithm; tiny where the camera is known.
    pub focal_sigma: f64,
    pub landmarks: Vec<Landmark>,
    /// What is expected of fitted keypoint offsets, and its spread, metres.
    pub offsets: [DVec3; N_OFFSETS],
    pub offset_sigma: [f64; N_OFFSETS],
    /// The keypoints' detector has habits that are known: they are no rig's.
    pub known_detector: bool,
    pub points: Vec<Point>,
    /// `[N][K]`
    pub observations: Vec<Vec<Observation>>,
    /// `[N − 1]`: time to the next frame, in hundredths of the clip, or of a turn where it has several.
    pub gaps: Vec<f64>,
    pub surface: Vec<Point>,
    /// `[N]`, empty before masks are used.
    pub contours: Vec<Vec<ContourPoint>>,
    /// Empty before pictures are looked at.
    pub tracks: Tracks,
    pub given: Option<Given>,
    /// About which frames sway, where detections cannot be trusted to tell.
    pub stance: Option<Stance>,
    /// `[N]`: the arms and heads that do something else than hang and look ahead; empty before they are looked for.
    pub lively: Vec<Lively>,
    pub steps: Steps,
}

/// `ρ²/(q + ρ²)`: the part of a squared error `q` that Geman and McClure count.
fn geman_mcclure_share(q: f64, rho: f64) -> f64 {
    let r2 = rho * rho;
    r2 / (q + r2)
}

/// `½ ρ²q/(q + ρ²)` and its derivative with respect to `½ q`.
pub(in crate::fit) fn geman_mcclure(q: f64, rho: f64) -> (f64, f64) {
    let share = geman_mcclure_share(q, rho);
    (0.5 * q * share, share * share)
}

/// A squared error `q` of a Student's t of `tail` degrees of freedom, without what does not depend on it: `½ ν ln(1 + q/ν)`, and its
/// derivative with respect to `½ q`. A Gaussian's is `½ q`.
pub(super) fn heavy_tailed(q: f64, tail: f64) -> (f64, f64) {
    (0.5 * tail * (q / tail).ln_1p(), 1.0 / (1.0 + q / tail))
}

/// Where a landmark's offset stands, what it is and which of its axes count.
fn offset_of(landmark: &Landmark, shared: &Shared) -> Option<(usize, DVec3, DVec3)> {
    let slot = landmark.part.offset()?;
    Some((slot, shared.offsets[slot], DVec3::new(landmark.side, 1.0, 1.0)))
}

/// One frame of a state, posed.
struct Look<'a> {
    t: usize,
    posed: &'a Posed,
    shared: &'a Shared,
    camera: &'a Pinhole,
    scales: &'a Scales,
}

/// Where a frame shows a point, and how sure that is.
struct Place<'a> {
    point: &'a Point,
    /// First column, value and the factors of the axes of its fitted displacement, see [`Rig::differentiate`].
    offset: Option<(usize, DVec3, DVec3)>,
    at: DVec2,
    weight: f64,
    sigma_px: f64,
    /// Geman–McClure's ρ in multiples of σ.
    rho: f64,
}

/// Buffers of one evaluation.
#[derive(Default)]
struct Rows {
    jacobian: PointJacobian,
    frame: Vec<(usize, f64)>,
    shared: Vec<(usize, f64)>,
}

impl Rows {
    /// The slopes of `direction · image(point)`.
    fn along(&mut self, slope: DVec3, focal_column: usize, focal_slope: f64) {
        self.frame.clear();
        self.frame.extend(self.jacobian.frame.iter().map(|(c, d)| (*c, slope.dot(*d))));
        self.shared.clear();
        self.shared.extend(self.jacobian.shared.iter().map(|(c, d)| (*c, slope.dot(*d))));
        self.shared.push((focal_column, focal_slope));
    }
}

impl Problem {
    /// What is lively in a frame.
    pub(super) fn lively_at(&self, t: usize) -> Lively {
        self.lively.get(t).copied().unwrap_or_default()
    }

    /// The cost of a state; with `normal`, its equations are added.
    pub fn evaluate(&self, state: &State, scales: &Scales, mut normal: Option<&mut Normal>) -> f64 {
        let camera = self.camera.zoomed(state.shared.log_focal);
        let mut rows = Rows::default();
        let mut cost = self.shared_prior(&state.shared, scales, normal.as_deref_mut());
        for (t, frame) in state.frames.iter().enumerate() {
            let posed = self.rig.pose(frame, &state.shared);
            let look = Look { t, posed: &posed, shared: &state.shared, camera: &camera, scales };
            cost += self.keypoints(&look, &mut rows, normal.as_deref_mut());
            cost += self.outline(&look, &mut rows, normal.as_deref_mut());
            cost += self.sightings(&look, &mut rows, normal.as_deref_mut());
            cost += match &self.given {
                Some(given) => self.anchored(t, frame, given, normal.as_deref_mut()),
                None => self.pose_prior(t, frame, self.lively_at(t), normal.as_deref_mut()),
            };
            cost += self.step_prior(t, frame, normal.as_deref_mut());
        }
        if self.given.is_none() {
            for t in 0..self.gaps.len() {
                cost += self.smoothness(t, state, normal.as_deref_mut());
            }
        }
        cost
    }

    /// What keypoints alone say of every frame.
    pub fn seen_alone(&self, state: &State, scales: &Scales) -> Normal {
        let mut normal = Normal::new(state.frames.len(), self.layout.n_frame, self.layout.n_shared);
        let camera = self.camera.zoomed(state.shared.log_focal);
        let mut rows = Rows::default();
        for (t, frame) in state.frames.iter().enumerate() {
            let posed = self.rig.pose(frame, &state.shared);
            let look = Look { t, posed: &posed, shared: &state.shared, camera: &camera, scales };
            self.keypoints(&look, &mut rows, Some(&mut normal));
        }
        normal
    }

    /// What keypoints and the standing prior make of one frame.
    pub fn of_frame(&self, t: usize, frame: &Frame, shared: &Shared, scales: &Scales) -> f64 {
        self.of_lively_frame(t, frame, self.lively_at(t), shared, scales)
    }

    /// The same, were this lively in it.
    pub fn of_lively_frame(&self, t: usize, frame: &Frame, lively: Lively, shared: &Shared, scales: &Scales) -> f64 {
        let camera = self.camera.zoomed(shared.log_focal);
        let posed = self.rig.pose(frame, shared);
        let look = Look { t, posed: &posed, shared, camera: &camera, scales };
        self.keypoints(&look, &mut Rows::default(), None) + self.pose_prior(t, frame, lively, None)
    }

    /// A person's height in pixels, as far away as the state has this one.
    pub fn height_px(&self, state: &State) -> f64 {
        let depths: f64 = state.frames.iter().map(|f| f.pelvis.z.max(0.1)).sum::<f64>() / state.frames.len() as f64;
        NOMINAL_HEIGHT_M * self.camera.zoomed(state.shared.log_focal).fy / depths
    }

    /// Where every landmark of a posed body appears.
    pub fn landmarks_at(&self, posed: &Posed, state: &State, camera: &Pinhole) -> Vec<DVec2> {
        let place = |(landmark, point): (&Landmark, &Point)| {
            let added = offset_of(landmark, &state.shared).map_or(DVec3::ZERO, |(_, value, factors)| value * factors);
            camera.project(posed.place(point, &state.shared.betas, added))
        };
        self.landmarks.iter().zip(&self.points).map(place).collect()
    }

    fn keypoints(&self, look: &Look, rows: &mut Rows, mut normal: Option<&mut Normal>) -> f64 {
        let Look { t, shared, scales, .. } = *look;
        let mut cost = 0.0;
        for (k, seen) in self.observations[t].iter().enumerate().filter(|(_, o)| o.weight > 0.0) {
            let offset = offset_of(&self.landmarks[k], shared);
            let place = Place {
                point: &self.points[k],
                offset: offset.map(|(slot, value, factors)| (self.layout.offset_column(slot), value, factors)),
                at: seen.at,
                weight: seen.weight,
                sigma_px: scales.sigma_px,
                rho: scales.rho,
            };
            cost += self.seen(look, &place, rows, normal.as_deref_mut());
        }
        cost
    }

    fn sightings(&self, look: &Look, rows: &mut Rows, mut normal: Option<&mut Normal>) -> f64 {
        let Look { t, shared, scales, .. } = *look;
        let mut cost = 0.0;
        for sighting in self.tracks.sightings.get(t).into_iter().flatten() {
            let n = sighting.point;
            let place = Place {
                point: &self.tracks.points[n],
                offset: Some((self.layout.tracked_column(n), shared.tracked[n], DVec3::ONE)),
                at: sighting.at,
                weight: tracks::WEIGHT,
                sigma_px: scales.track_px,
                rho: tracks::RHO,
            };
            cost += self.seen(look, &place, rows, normal.as_deref_mut());
        }
        cost
    }

    /// A point of the body that a frame shows at a place.
    fn seen(&self, look: &Look, place: &Place, rows: &mut Rows, normal: Option<&mut Normal>) -> f64 {
        let Look { t, posed, shared, camera, .. } = *look;
        let Place { point, offset, at, weight, sigma_px, rho } = *place;
        let information = 1.0 / (sigma_px * sigma_px);
        let betas = &shared.betas;
        let place = if normal.is_some() {
            self.rig.differentiate(posed, point, betas, offset, &self.layout, &mut rows.jacobian)
        } else {
            posed.place(point, betas, offset.map_or(DVec3::ZERO, |(_, value, factors)| value * factors))
        };
        let image = camera.project(place);
        let error = image - at;
        let (value, influence) = geman_mcclure(error.length_squared() * information, rho);
        if let Some(normal) = normal {
            let pull = weight * influence * information;
            let [u, v] = camera.slopes(place);
            rows.along(u, self.layout.focal_column(), image.x - camera.cx);
            normal.add(t, &rows.frame, &rows.shared, error.x, pull);
            rows.along(v, self.layout.focal_column(), image.y - camera.cy);
            normal.add(t, &rows.frame, &rows.shared, error.y, pull);
        }
        weight * value
    }

    fn outline(&self, look: &Look, rows: &mut Rows, mut normal: Option<&mut Normal>) -> f64 {
        let Look { t, posed, shared, camera, scales } = *look;
        let mut cost = 0.0;
        let points = if scales.contour_weight > 0.0 { self.contours.get(t) } else { None };
        for contour in points.into_iter().flatten() {
            let point = &self.surface[contour.vertex];
            let place = if normal.is_some() {
                self.rig.differentiate(posed, point, &shared.betas, None, &self.layout, &mut rows.jacobian)
            } else {
                posed.place(point, &shared.betas, DVec3::ZERO)
            };
            let image = camera.project(place);
            let error = contour.normal.dot(image - contour.at);
            let sigma = if error > 0.0 { scales.contour_outside_px } else { scales.contour_inside_px };
            let (value, influence) = geman_mcclure(error * error / (sigma * sigma), 3.0);
            cost += scales.contour_weight * value;
            if let Some(normal) = normal.as_deref_mut() {
                let [u, v] = camera.slopes(place);
                let slope = u * contour.normal.x + v * contour.normal.y;
                let zoom = contour.normal.dot(image - DVec2::new(camera.cx, camera.cy));
                rows.along(slope, self.layout.focal_column(), zoom);
                let weight = scales.contour_weight * influence / (sigma * sigma);
                normal.add(t, &rows.frame, &rows.shared, error, weight);
            }
        }
        cost
    }
}
