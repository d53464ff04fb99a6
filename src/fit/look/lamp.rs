//! The clip's light from face colours: since the light stands still and the person turns, a face is seen at many angles to
//! the lamp and in and out of the body's own shadow; what changes with them is light, what stays is albedo.

use rayon::prelude::*;

use super::shadows::PosedClip;
use crate::ops::light::{Exposure, Light};

/// A face in a frame.
#[derive(Clone, Copy, Debug)]
pub struct Observation {
    pub frame: u32,
    pub face: u32,
    /// Pixels that showed it
    pub weight: f32,
    /// Of these, those well inside the mask
    pub inside: f32,
    /// Their mean, sRGB
    pub colour: [f32; 3],
    /// Unit, world space
    pub normal: [f32; 3],
}

/// Observations that the search looks at, at most: enough for eight numbers, few enough for a second.
const MAX_SEARCHED: usize = 40_000;
/// Directions that are tried without shadows: round the person, and above the horizon.
const AZIMUTHS: usize = 24;
const ELEVATIONS_DEG: [f64; 3] = [15.0, 35.0, 55.0];
/// Directions that are tried with shadows: first these elevations at the best azimuth without shadows, then what lies beside the best
/// by the first of these steps for as long as that is better, then by the next.
const SHADOWED_ELEVATIONS_DEG: [f64; 4] = [20.0, 32.0, 44.0, 56.0];
const STEPS_DEG: [f64; 2] = [12.0, 6.0];
/// How far it goes aside, at most, and between which elevations it stays.
const MAX_ASIDE_DEG: f64 = 48.0;
const ELEVATION_RANGE_DEG: [f64; 2] = [10.0, 70.0];
/// Frames whose shadows are cast for each direction that is tried.
const SHADOWED_FRAMES: usize = 12;
/// Rounds of alternation between albedo and light, in the search and for its winner.
const SEARCH_ROUNDS: usize = 8;
const FINAL_ROUNDS: usize = 25;
/// A turn about the vertical hardly shows how high the lamp stands. Lamps stand above: each 30° from this elevation count
/// as one percent more error.
const USUAL_ELEVATION_DEG: f64 = 45.0;
/// The power of openness that is left of the ambient light ([`Light::occlusion`]). A person who turns as one keeps a point's
/// openness, so the clip does not tell it; measured on two persons who move in other pictures (docs/lab/light.md).
const OCCLUSION: f32 = 0.35;
/// Ambient light is brighter from the camera's side, or not; that side is this far above the horizon.
const CAMERA_SIDE_DEG: f64 = 20.0;
/// The error without a lamp has to be larger than with one by this factor, else there is none to be told.
const MIN_GAIN: f64 = 1.02;
/// Residuals beyond this count linearly: wrong geometry is no light.
const ROBUST: f32 = 0.05;
/// No part of a body is darker than this part of its mean look.
const MIN_SHADE: f32 = 0.05;
/// From here on a camera shows everything brighter alike. What is brighter than such a colour does not contradict it.
const WHITE: f32 = 0.97;

/// The world's directions as the clip has them.
#[derive(Clone, Copy)]
pub struct Sky {
    up: glam::DVec3,
    /// Level, towards the camera
    back: glam::DVec3,
    side: glam::DVec3,
}

impl Sky {
    /// `up`: against gravity; `forward`: the camera's view.
    pub fn new(up: [f32; 3], forward: [f32; 3]) -> Self {
        let vector = |v: [f32; 3]| glam::DVec3::from(v.map(f64::from));
        let up = vector(up).normalize();
        let back = -vector(forward).reject_from(up).normalize();
        Self { up, back, side: up.cross(back) }
    }

    /// The unit vector `azimuth` (radians) round the vertical from straight towards the camera, above the horizon.
    fn direction(&self, azimuth: f64, elevation_deg: f64) -> [f32; 3] {
        let elevation = elevation_deg.to_radians();
        let flat = self.back * azimuth.cos() + self.side * azimuth.sin();
        (flat * elevation.cos() + self.up * elevation.sin()).to_array().map(|x| x as f32)
    }

    /// How much of ambient light from the camera's side, [`CAMERA_SIDE_DEG`] above the horizon, and from above a unit normal
    /// gets, 0 to 1.
    fn slopes(&self, n: [f32; 3]) -> [f32; 2] {
        self.sides().map(|side| 0.5 + 0.5 * side.dot(n.into()))
    }

    fn sides(&self) -> [glam::Vec3; 2] {
        [self.direction(0.0, CAMERA_SIDE_DEG).into(), self.up.as_vec3()]
    }

    /// The light of the weights of [`TERMS`]; without a normal it is `ambient`, so half of what comes from one side counts there.
    fn light(&self, direction: [f32; 3], [everywhere, front, above, strength]: Weights) -> Light {
        let ambient = everywhere + 0.5 * (front + above);
        let [camera, up] = self.sides();
        let slope = if ambient > 0.0 { 0.5 * (front * camera + above * up) / ambient } else { glam::Vec3::ZERO };
        let slope = slope.to_array();
        Light { ambient: [ambient; 3], strength: [strength; 3], direction, occlusion: 0.0, slope }
    }

    fn azimuth(&self, direction: [f32; 3]) -> f64 {
        let direction = glam::DVec3::from(direction.map(f64::from));
        direction.dot(self.side).atan2(direction.dot(self.back))
    }
}

/// The light that explains the observations best, were there no shadows and no corners; [`Light::EVEN`] where no lamp can be told
/// from them. Shades are one in the mean of the observations.
pub fn solve_light(observations: &[Observation], n_faces: usize, sky: &Sky) -> Light {
    let searched = searched(observations, |_| true);
    let all_seen = |direction: [f32; 3]| {
        let lamp = Light { strength: [1.0; 3], direction, ..DARK };
        Problem::new(&searched, n_faces, move |o| [1.0, 0.0, 0.0, lamp.shade(o.normal, Exposure::FULL)[0]])
    };
    let even = all_seen(Light::EVEN.direction).solve(0);
    let azimuths = (0..AZIMUTHS).map(|k| std::f64::consts::TAU * k as f64 / AZIMUTHS as f64);
    let tried: Vec<(f64, f64)> =
        azimuths.flat_map(|azimuth| ELEVATIONS_DEG.map(|elevation| (azimuth, elevation))).collect();
    let (cost, (azimuth, elevation)) = cheapest(&tried, |(azimuth, elevation)| {
        all_seen(sky.direction(azimuth, elevation)).solve(SEARCH_ROUNDS).error * unusual(elevation)
    });
    let direction = sky.direction(azimuth, elevation);
    if even.error <= MIN_GAIN * cost {
        return Light::EVEN;
    }
    sky.light(direction, all_seen(direction).solve(FINAL_ROUNDS).weights)
}

/// The light near `start` that explains the observations best with the shadows that the body casts on itself in each frame of
/// `clip`, with ambient light that is less where the body shuts itself in and brighter from the camera's side or from above, and
/// what of it reaches each vertex, `[N][V]`.
pub fn solve_shadowed_light(
    observations: &[Observation],
    faces: &[[u32; 3]],
    start: &Light,
    sky: &Sky,
    clip: &PosedClip<'_>,
) -> (Light, Vec<Vec<Exposure>>) {
    let n = clip.n_frames();
    let open = clip.openness();
    let unit = |direction: [f32; 3]| Light { strength: [1.0; 3], direction, occlusion: OCCLUSION, ..DARK };
    let terms = |o: &Observation, lamp: &Light, exposures: &[Exposure]| {
        let exposure = of_face(exposures, faces[o.face as usize]);
        let [front, above] = sky.slopes(o.normal);
        let ambient = exposure.ambient;
        [ambient, ambient * front, ambient * above, lamp.shade(o.normal, exposure)[0]]
    };
    let exposures = |lamp: &Light, frames: &[usize]| -> Vec<Vec<Exposure>> {
        let visible = clip.visibility(lamp.direction, frames);
        let both = frames.iter().zip(visible).map(|(&frame, visible)| open[frame].iter().zip(visible));
        both.map(|both| both.map(|(&open, visible)| lamp.exposure(open, visible)).collect()).collect()
    };

    let some: Vec<usize> = (0..n).step_by(n.div_ceil(SHADOWED_FRAMES).max(1)).collect();
    let in_some = searched(observations, |o| some.binary_search(&(o.frame as usize)).is_ok());
    let around = sky.azimuth(start.direction);
    let towards = |[aside, elevation]: [f64; 2]| sky.direction(around + aside.to_radians(), elevation);
    let cost = |place: [f64; 2]| {
        let lamp = unit(towards(place));
        let exposures = exposures(&lamp, &some);
        let of = |o: &Observation| {
            let frame = some.binary_search(&(o.frame as usize)).unwrap_or(0);
            terms(o, &lamp, &exposures[frame])
        };
        Problem::new(&in_some, faces.len(), of).solve(SEARCH_ROUNDS).error * unusual(place[1])
    };
    let mut best = cheapest(&SHADOWED_ELEVATIONS_DEG.map(|elevation| [0.0, elevation]), cost);
    for step in STEPS_DEG {
        loop {
            let beside = [[-1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [0.0, 1.0]].map(|by: [f64; 2]| {
                let [aside, elevation] = [0, 1].map(|k| best.1[k] + step * by[k]);
                let [low, high] = ELEVATION_RANGE_DEG;
                [aside.clamp(-MAX_ASIDE_DEG, MAX_ASIDE_DEG), elevation.clamp(low, high)]
            });
            let next = cheapest(&beside, cost);
            if next.0.total_cmp(&best.0).is_ge() {
                break;
            }
            best = next;
        }
    }
    let direction = towards(best.1);
    let all: Vec<usize> = (0..n).collect();
    let lamp = unit(direction);
    let exposures = exposures(&lamp, &all);
    let searched = searched(observations, |_| true);
    let of = |o: &Observation| terms(o, &lamp, &exposures[o.frame as usize]);
    let solved = Problem::new(&searched, faces.len(), of).solve(FINAL_ROUNDS);
    (Light { occlusion: OCCLUSION, ..sky.light(direction, solved.weights) }, exposures)
}

/// No light at all.
const DARK: Light = Light { ambient: [0.0; 3], ..Light::EVEN };

/// What reaches a face: the mean of its corners.
pub fn of_face(exposures: &[Exposure], face: [u32; 3]) -> Exposure {
    Exposure::weighted(face.into_iter().map(|v| (1.0 / 3.0, exposures[v as usize])))
}

/// Some of the observations that count, not too many.
fn searched(observations: &[Observation], counts: impl Fn(&Observation) -> bool) -> Vec<Observation> {
    let n = observations.iter().filter(|o| counts(o)).count();
    let every = n.div_ceil(MAX_SEARCHED).max(1) as u32;
    // Whole faces, so that each keeps its angles. Chosen by a hash: neighbours have neighbouring numbers.
    let chosen = |o: &&Observation| o.face.wrapping_mul(0x9e37_79b9) >> 8 & 0xffff < 0x1_0000 / every;
    observations.iter().filter(|o| counts(o)).filter(chosen).copied().collect()
}

/// The lowest cost of what is tried, and what has it, the first of several; on all cores.
///
/// # Panics
/// When nothing was tried.
fn cheapest<P: Copy + Sync>(tried: &[P], cost: impl Fn(P) -> f64 + Sync) -> (f64, P) {
    let costs: Vec<f64> = tried.par_iter().map(|&place| cost(place)).collect();
    let all = costs.into_iter().zip(tried.iter().copied());
    all.min_by(|a, b| a.0.total_cmp(&b.0)).expect("directions are tried")
}

/// The least squares of `½ x·matrix·x − right·x` with no x below zero, from `start`: one number after the other (Gauss–Seidel).
/// A term that is nowhere has none.
fn not_below_zero(matrix: &[[f64; TERMS]; TERMS], right: &[f64; TERMS], start: [f64; TERMS]) -> [f64; TERMS] {
    let mut x = start;
    for _ in 0..DESCENT_ROUNDS {
        for k in 0..TERMS {
            let others: f64 = (0..TERMS).filter(|&j| j != k).map(|j| matrix[k][j] * x[j]).sum();
            x[k] = if matrix[k][k] > 0.0 { ((right[k] - others) / matrix[k][k]).max(0.0) } else { 0.0 };
        }
    }
    x
}

/// Rounds of it: ambient light and what of it comes from one side are much alike.
const DESCENT_ROUNDS: usize = 400;

/// What the error counts at an elevation.
fn unusual(elevation_deg: f64) -> f64 {
    1.0 + 0.01 * (elevation_deg - USUAL_ELEVATION_DEG).abs() / 30.0
}

/// Albedos `[F, 3]` under a light, in closed form, and the pixels that showed each face. `exposure`: what reached an
/// observation's face.
pub fn albedos(
    observations: &[Observation],
    n_faces: usize,
    light: &Light,
    exposure: impl Fn(&Observation) -> Exposure,
) -> (Vec<f32>, Vec<f32>) {
    let mut counts = vec![0.0f32; n_faces];
    observations.iter().for_each(|o| counts[o.face as usize] += o.weight);
    // White, as the solved lights are.
    let problem = Problem::new(observations, n_faces, |o| [light.shade(o.normal, exposure(o))[0], 0.0, 0.0, 0.0]);
    let weights = [1.0, 0.0, 0.0, 0.0];
    let mut albedo = problem.first_albedo(weights);
    for _ in 0..ALBEDO_ROUNDS {
        albedo = problem.albedo(weights, &albedo);
    }
    (albedo.into_flattened(), counts)
}

/// Rounds in which it settles what is brighter than white.
const ALBEDO_ROUNDS: usize = 3;

/// What makes up a shade, each with a weight of its own that is not below zero: ambient light from everywhere, from the camera's
/// side and from above ([`Light::slope`]), and the lamp.
const TERMS: usize = 4;
type Weights = [f32; TERMS];

/// Albedos and the weights of the light for one direction of the lamp.
struct Problem<'a> {
    observations: &'a [Observation],
    n_faces: usize,
    /// Of each observation
    terms: Vec<[f32; TERMS]>,
}

struct Solved {
    weights: Weights,
    /// Mean absolute error a pixel and channel.
    error: f64,
}

/// Whether a channel of an observation says something about what would be `bright`.
fn tells(colour: f32, bright: f32) -> bool {
    colour < WHITE || bright < colour
}

impl<'a> Problem<'a> {
    fn new(observations: &'a [Observation], n_faces: usize, terms: impl Fn(&Observation) -> [f32; TERMS]) -> Self {
        Self { observations, n_faces, terms: observations.iter().map(terms).collect() }
    }

    /// Alternates `rounds` times between the albedos and the light; no rounds are even light. The light is white: told a
    /// channel, it takes on the colours of what happens to face the lamp, and the dark side of grey trousers turns brown.
    fn solve(&self, rounds: usize) -> Solved {
        let mut weights = self.normalised(if rounds == 0 { [1.0, 0.0, 0.0, 0.0] } else { [0.7, 0.0, 0.0, 0.5] });
        let mut albedo = self.first_albedo(weights);
        for _ in 0..rounds {
            weights = self.normalised(self.light_of(&albedo, weights));
            albedo = self.albedo(weights, &albedo);
        }
        Solved { weights, error: self.error(&albedo, weights) }
    }

    fn shade(&self, i: usize, weights: Weights) -> f32 {
        let terms = self.terms[i].iter().zip(weights);
        terms.map(|(term, weight)| term * weight).sum::<f32>().max(MIN_SHADE)
    }

    /// `[F]`, from what is not white; where a face was never seen otherwise, from that.
    fn first_albedo(&self, weights: Weights) -> Vec<[f32; 3]> {
        let all = self.mean_albedo(weights, |_, _| true, &[]);
        self.mean_albedo(weights, |colour, _| colour < WHITE, &all)
    }

    /// `[F]`, after `before`.
    fn albedo(&self, weights: Weights, before: &[[f32; 3]]) -> Vec<[f32; 3]> {
        self.mean_albedo(weights, tells, before)
    }

    /// Least squares over the channels of which `counts(colour, bright)` holds, `bright` by the albedos `before`, which stand
    /// where none does.
    fn mean_albedo(&self, weights: Weights, counts: impl Fn(f32, f32) -> bool, before: &[[f32; 3]]) -> Vec<[f32; 3]> {
        let mut sums = vec![([0.0f32; 3], [0.0f32; 3]); self.n_faces];
        let known = |face: usize| before.get(face).copied().unwrap_or_default();
        for (i, o) in self.observations.iter().enumerate() {
            let shade = self.shade(i, weights);
            let (top, bottom) = &mut sums[o.face as usize];
            for (k, albedo) in known(o.face as usize).into_iter().enumerate() {
                if counts(o.colour[k], albedo * shade) {
                    top[k] += o.weight * o.colour[k] * shade;
                    bottom[k] += o.weight * shade * shade;
                }
            }
        }
        let mean = |(face, (top, bottom)): (usize, ([f32; 3], [f32; 3]))| {
            let before = known(face);
            std::array::from_fn(|k| if bottom[k] > 0.0 { top[k] / bottom[k] } else { before[k] })
        };
        sums.into_iter().enumerate().map(mean).collect()
    }

    /// Reweighted least squares for the weights, none below zero.
    fn light_of(&self, albedo: &[[f32; 3]], weights: Weights) -> Weights {
        let (mut matrix, mut right) = ([[0.0f64; TERMS]; TERMS], [0.0f64; TERMS]);
        for (i, o) in self.observations.iter().enumerate() {
            let shade = self.shade(i, weights);
            for (albedo, colour) in albedo[o.face as usize].into_iter().zip(o.colour) {
                if !tells(colour, albedo * shade) {
                    continue;
                }
                let weight = f64::from(o.weight / ((albedo * shade - colour).abs() + ROBUST));
                let terms = self.terms[i].map(|term| f64::from(albedo * term));
                for (j, row) in matrix.iter_mut().enumerate() {
                    let weighted = weight * terms[j];
                    right[j] += weighted * f64::from(colour);
                    row.iter_mut().zip(terms).for_each(|(sum, term)| *sum += weighted * term);
                }
            }
        }
        not_below_zero(&matrix, &right, weights.map(f64::from)).map(|x| x as f32)
    }

    /// Scaled so that the mean shade is one: the albedo is then as bright as the person looked in the mean.
    fn normalised(&self, by: Weights) -> Weights {
        let (mut sum, mut weights) = (0.0f64, 0.0f64);
        for (i, o) in self.observations.iter().enumerate() {
            sum += f64::from(o.weight * self.shade(i, by));
            weights += f64::from(o.weight);
        }
        let mean = if weights > 0.0 { (sum / weights) as f32 } else { 1.0 };
        by.map(|weight| weight / mean)
    }

    fn error(&self, albedo: &[[f32; 3]], weights: Weights) -> f64 {
        let (mut sum, mut pixels) = (0.0f64, 0.0f64);
        for (i, o) in self.observations.iter().enumerate() {
            let shade = self.shade(i, weights);
            for (albedo, colour) in albedo[o.face as usize].into_iter().zip(o.colour) {
                if tells(colour, albedo * shade) {
                    sum += f64::from(o.weight * (albedo * shade - colour).abs());
                }
            }
            pixels += 3.0 * f64::from(o.weight);
        }
        sum / pixels.max(1e-12)
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};

    use super::*;

    fn sky() -> Sky {
        Sky::new([0.0, -1.0, 0.0], [0.0, 0.0, 1.0])
    }

    /// Faces of a turning person of random colours, each seen while it looks at the camera.
    fn turning(light: &Light, turn_deg: f32) -> Vec<Observation> {
        let mut rng = rand_pcg::Pcg32::seed_from_u64(3);
        let mut observations = Vec::new();
        for face in 0..400 {
            let albedo: [f32; 3] = std::array::from_fn(|_| 0.2 + 0.5 * rng.random::<f32>());
            let (at, tilt) = (std::f32::consts::TAU * rng.random::<f32>(), 1.6 * rng.random::<f32>() - 0.8);
            for frame in 0..40 {
                let angle = at + turn_deg.to_radians() * frame as f32 / 40.0;
                let normal = [angle.sin() * tilt.cos(), tilt.sin(), -angle.cos() * tilt.cos()];
                if normal[2] < -0.2 {
                    let shade = light.shade(normal, Exposure::FULL);
                    let noise = 0.01 * (rng.random::<f32>() - 0.5);
                    let colour = std::array::from_fn(|k| (albedo[k] * shade[k] + noise).min(1.0));
                    observations.push(Observation { frame, face, weight: 4.0, inside: 4.0, colour, normal });
                }
            }
        }
        observations
    }

    fn angle_deg(a: [f32; 3], b: [f32; 3]) -> f32 {
        (0..3).map(|k| a[k] * b[k]).sum::<f32>().clamp(-1.0, 1.0).acos().to_degrees()
    }

    #[test]
    fn a_lamp_is_found_from_a_turn() {
        let truth = Light { strength: [0.7, 0.6, 0.5], occlusion: 0.0, ..lamp(0.7, 35.0) };
        let found = solve_light(&turning(&truth, 360.0), 400, &sky());
        assert!(angle_deg(found.direction, truth.direction) < 15.0, "{found:?}");
        for k in 0..3 {
            let (ours, want) = (found.strength[k] / found.ambient[k], truth.strength[k] / truth.ambient[k]);
            assert!((ours / want - 1.0).abs() < 0.25, "channel {k}: {ours} instead of {want}");
        }
    }

    #[test]
    fn what_the_camera_cut_off_does_not_darken_the_albedo() {
        let light = Light { ambient: [0.6; 3], strength: [1.0; 3], direction: sky().direction(0.0, 0.0), ..DARK };
        let (lit, dark) = ([0.0, 0.0, -1.0], [0.0, 0.0, 1.0]);
        let seen = [lit, lit, lit, dark].map(|normal| {
            let colour = light.shade(normal, Exposure::FULL).map(|shade| (0.9 * shade).min(1.0));
            Observation { frame: 0, face: 0, weight: 1.0, inside: 1.0, colour, normal }
        });
        let (albedo, _) = albedos(&seen, 1, &light, |_| Exposure::FULL);
        assert!(albedo.iter().all(|a| (a - 0.9).abs() < 1e-4), "{albedo:?}");
        // All white: at least so bright as to be white.
        let (albedo, _) = albedos(&seen[..3], 1, &light, |_| Exposure::FULL);
        assert!(albedo.iter().all(|a| (a * 1.6 - 1.0).abs() < 1e-4), "{albedo:?}");
    }

    /// The small body turning once in 16 frames.
    fn turning_body(body: &crate::body::Body) -> PosedClip<'_> {
        let turned = |k: usize| {
            let turn = glam::Quat::from_rotation_x(std::f32::consts::PI)
                * glam::Quat::from_rotation_y(std::f32::consts::TAU * k as f32 / 16.0);
            let mut pose = [0.0; crate::body::N_POSE];
            pose[..3].copy_from_slice(&turn.to_scaled_axis().to_array());
            crate::ops::skinning::cpu::forward(body, &[], None, &pose, [0.0, 0.0, 3.0]).vertices
        };
        PosedClip { faces: &body.faces, vertices: (0..16).map(turned).collect() }
    }

    /// What a camera in the origin sees of it.
    fn observed(clip: &PosedClip<'_>, light: &Light) -> Vec<Observation> {
        let exposures = clip.exposures(light);
        let mut seen = Vec::new();
        for (frame, vertices) in clip.vertices.iter().enumerate() {
            for (f, &face) in clip.faces.iter().enumerate() {
                let [a, b, c] = face.map(|v| glam::Vec3::from(vertices[v as usize]));
                let normal = (b - a).cross(c - a).normalize_or_zero();
                if normal.dot(a) >= 0.0 {
                    continue;
                }
                let normal = normal.to_array();
                let shade = light.shade(normal, of_face(&exposures[frame], face));
                let colour = std::array::from_fn(|k| (0.2 + 0.1 * ((f + k) % 5) as f32) * shade[k]);
                seen.push(Observation {
                    frame: frame as u32,
                    face: f as u32,
                    weight: 1.0,
                    inside: 1.0,
                    colour,
                    normal,
                });
            }
        }
        seen
    }

    fn lamp(azimuth: f64, elevation_deg: f64) -> Light {
        let direction = sky().direction(azimuth, elevation_deg);
        Light { ambient: [0.6; 3], strength: [0.7; 3], direction, occlusion: OCCLUSION, slope: [0.0; 3] }
    }

    #[test]
    fn shadows_tell_how_high_the_lamp_stands() {
        let body = crate::body::Body::test_body();
        let (clip, light) = (turning_body(&body), lamp(0.6, 44.0));
        let seen = observed(&clip, &light);
        // From 23° aside.
        let (found, reaching) = solve_shadowed_light(&seen, &body.faces, &lamp(1.0, 15.0), &sky(), &clip);
        assert!(angle_deg(found.direction, light.direction) < 6.0, "{found:?}");
        let (ours, want) = (found.strength[0] / found.ambient[0], light.strength[0] / light.ambient[0]);
        assert!((ours / want - 1.0).abs() < 0.15, "{ours} instead of {want}");
        assert!(glam::Vec3::from(found.slope).length() < 0.1, "even ambient light: {found:?}");
        assert_eq!((reaching.len(), reaching[0].len()), (16, body.n_vertices()));
    }

    #[test]
    fn ambient_light_that_is_brighter_from_the_cameras_side_is_told() {
        let body = crate::body::Body::test_body();
        let clip = turning_body(&body);
        let slope = (0.25 * sky().sides()[0]).to_array();
        let light = Light { slope, ..lamp(0.6, 32.0) };
        let (found, _) = solve_shadowed_light(&observed(&clip, &light), &body.faces, &lamp(0.6, 15.0), &sky(), &clip);
        let off = (glam::Vec3::from(found.slope) - glam::Vec3::from(slope)).length();
        assert!(off < 0.08, "{:?} instead of {slope:?}", found.slope);
    }

    #[test]
    fn least_squares_stop_at_zero() {
        // x₁ would be negative beside x₀; the third and the fourth number occur nowhere.
        let mut matrix = [[0.0; TERMS]; TERMS];
        (matrix[0][0], matrix[1][1], matrix[0][1], matrix[1][0]) = (2.0, 2.0, 1.9, 1.9);
        let found = not_below_zero(&matrix, &[2.0, 1.0, 0.0, 0.0], [0.3; TERMS]);
        assert_eq!(found, [1.0, 0.0, 0.0, 0.0]);
        (matrix[0][1], matrix[1][0]) = (1.0, 1.0);
        let found = not_below_zero(&matrix, &[4.0, 5.0, 0.0, 0.0], [0.0; TERMS]);
        assert!((found[0] - 1.0).abs() < 1e-9 && (found[1] - 2.0).abs() < 1e-9, "{found:?}");
    }

    #[test]
    fn even_light_and_a_person_who_does_not_turn_show_no_lamp() {
        assert_eq!(solve_light(&turning(&Light::EVEN, 360.0), 400, &sky()), Light::EVEN);
        assert_eq!(solve_light(&turning(&lamp(0.7, 35.0), 0.0), 400, &sky()), Light::EVEN);
        assert_eq!(solve_light(&[], 400, &sky()), Light::EVEN);
    }

    #[test]
    fn albedos_are_what_is_left_without_the_light() {
        let light = lamp(0.7, 35.0);
        let seen = turning(&light, 360.0);
        let (with, counts) = albedos(&seen, 401, &light, |_| Exposure::FULL);
        let (without, _) = albedos(&seen, 401, &Light::EVEN, |_| Exposure::FULL);
        let error = |colours: &[f32]| -> f32 {
            seen.iter()
                .map(|o| (colours[3 * o.face as usize] * light.shade(o.normal, Exposure::FULL)[0] - o.colour[0]).abs())
                .sum()
        };
        assert!(error(&with) < 0.1 * error(&without));
        assert_eq!((counts[400], with[1200]), (0.0, 0.0), "nobody saw the last face");
    }
}
