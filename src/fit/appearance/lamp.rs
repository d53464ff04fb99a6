//! The clip's light from face colours: since the light stands still and the person turns, a face is seen at many angles to
//! the lamp and in and out of the body's own shadow; what changes with them is light, what stays is albedo.

use rayon::prelude::*;

use super::albedo::{Observation, Problem};
use super::shadows::PosedClip;
use super::sky::Sky;
use crate::ops::light::{Exposure, Light};

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
pub(super) const OCCLUSION: f32 = 0.35;
/// The error without a lamp has to be larger than with one by this factor, else there is none to be told.
const MIN_GAIN: f64 = 1.02;

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
pub(super) const DARK: Light = Light { ambient: [0.0; 3], ..Light::EVEN };

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

/// What the error counts at an elevation.
fn unusual(elevation_deg: f64) -> f64 {
    1.0 + 0.01 * (elevation_deg - USUAL_ELEVATION_DEG).abs() / 30.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::appearance::testing::{lamp, sky, turning};

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
    fn even_light_and_a_person_who_does_not_turn_show_no_lamp() {
        assert_eq!(solve_light(&turning(&Light::EVEN, 360.0), 400, &sky()), Light::EVEN);
        assert_eq!(solve_light(&turning(&lamp(0.7, 35.0), 0.0), 400, &sky()), Light::EVEN);
        assert_eq!(solve_light(&[], 400, &sky()), Light::EVEN);
    }
}
