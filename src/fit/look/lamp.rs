//! The clip's light from face colours: since the light stands still and the person turns, a face is seen at many angles to
//! the lamp, and what changes with the angle is light, what stays is albedo.

use crate::ops::light::Light;

/// A face in a frame.
#[derive(Clone, Copy, Debug)]
pub struct Observation {
    pub face: u32,
    /// Pixels that showed it
    pub weight: f32,
    /// Their mean, sRGB
    pub colour: [f32; 3],
    /// Unit, world space
    pub normal: [f32; 3],
}

/// Observations that the search looks at, at most: enough for eight numbers, few enough for a second.
const MAX_SEARCHED: usize = 40_000;
/// Directions that are tried: round the person, and above the horizon.
const AZIMUTHS: usize = 24;
const ELEVATIONS_DEG: [f64; 3] = [15.0, 35.0, 55.0];
/// Rounds of alternation between albedo and light, in the search and for its winner.
const SEARCH_ROUNDS: usize = 8;
const FINAL_ROUNDS: usize = 25;
/// A turn about the vertical hardly shows how high the lamp stands. Lamps stand above: each 30° from this elevation count
/// as one percent more error.
const USUAL_ELEVATION_DEG: f64 = 45.0;
/// The error without a lamp has to be larger than with one by this factor, else there is none to be told.
const MIN_GAIN: f64 = 1.02;
/// Residuals beyond this count linearly: shadows and wrong geometry are no light.
const ROBUST: f32 = 0.05;
/// No part of a body is darker than this part of its mean look.
const MIN_SHADE: f32 = 0.05;

/// The light that explains the observations best; [`Light::EVEN`] where no lamp can be told from them. `up` is the world's
/// direction against gravity as the camera has it. Shades are one in the mean of the observations.
pub fn solve_light(observations: &[Observation], n_faces: usize, up: [f32; 3], forward: [f32; 3]) -> Light {
    let every = observations.len().div_ceil(MAX_SEARCHED).max(1) as u32;
    // Whole faces, so that each keeps its angles. Chosen by a hash: neighbours have neighbouring numbers.
    let searched: Vec<Observation> = observations
        .iter()
        .filter(|o| o.face.wrapping_mul(0x9e37_79b9) >> 8 & 0xffff < 0x1_0000 / every)
        .copied()
        .collect();
    let even = Problem::new(&searched, n_faces, Light::EVEN.direction).solve(0);
    let mut best: Option<(f64, Solved)> = None;
    for azimuth in 0..AZIMUTHS {
        for elevation in ELEVATIONS_DEG {
            let azimuth = std::f64::consts::TAU * azimuth as f64 / AZIMUTHS as f64;
            let solved =
                Problem::new(&searched, n_faces, direction(azimuth, elevation, up, forward)).solve(SEARCH_ROUNDS);
            let unusual = (elevation - USUAL_ELEVATION_DEG).abs() / 30.0;
            let cost = solved.error * (1.0 + 0.01 * unusual);
            if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                best = Some((cost, solved));
            }
        }
    }
    match best {
        Some((cost, solved)) if even.error > MIN_GAIN * cost => {
            Problem::new(&searched, n_faces, solved.light.direction).solve(FINAL_ROUNDS).light
        }
        _ => Light::EVEN,
    }
}

/// Albedos `[F, 3]` under a light, in closed form, and the pixels that showed each face.
pub fn albedos(observations: &[Observation], n_faces: usize, light: &Light) -> (Vec<f32>, Vec<f32>) {
    let (mut top, mut bottom) = (vec![0.0f32; 3 * n_faces], vec![0.0f32; 3 * n_faces]);
    let mut counts = vec![0.0f32; n_faces];
    for o in observations {
        let shade = light.shade(o.normal);
        counts[o.face as usize] += o.weight;
        for (k, (shade, colour)) in shade.into_iter().zip(o.colour).enumerate() {
            let at = 3 * o.face as usize + k;
            top[at] += o.weight * colour * shade;
            bottom[at] += o.weight * shade * shade;
        }
    }
    let colours = top.iter().zip(&bottom).map(|(t, b)| if *b > 0.0 { t / b } else { 0.0 }).collect();
    (colours, counts)
}

/// The unit vector `azimuth` round `up` from straight towards the camera, `elevation_deg` above the horizon.
fn direction(azimuth: f64, elevation_deg: f64, up: [f32; 3], forward: [f32; 3]) -> [f32; 3] {
    use glam::DVec3;
    let vector = |v: [f32; 3]| DVec3::from(v.map(f64::from));
    let up = vector(up).normalize();
    let back = -vector(forward).reject_from(up).normalize();
    let side = up.cross(back);
    let elevation = elevation_deg.to_radians();
    let flat = back * azimuth.cos() + side * azimuth.sin();
    (flat * elevation.cos() + up * elevation.sin()).to_array().map(|x| x as f32)
}

/// Albedo, ambient light and strength for one direction of the lamp.
struct Problem<'a> {
    observations: &'a [Observation],
    n_faces: usize,
    direction: [f32; 3],
    /// The lamp's part of the shade for each observation.
    lamp: Vec<f32>,
}

struct Solved {
    light: Light,
    /// Mean absolute error a pixel and channel.
    error: f64,
}

impl<'a> Problem<'a> {
    fn new(observations: &'a [Observation], n_faces: usize, direction: [f32; 3]) -> Self {
        let unit = Light { ambient: [0.0; 3], strength: [1.0; 3], direction };
        let lamp = observations.iter().map(|o| unit.shade(o.normal)[0]).collect();
        Self { observations, n_faces, direction, lamp }
    }

    /// Alternates `rounds` times between the albedos and the light; no rounds are even light. The light is white: told a
    /// channel, it takes on the colours of what happens to face the lamp, and the dark side of grey trousers turns brown.
    fn solve(&self, rounds: usize) -> Solved {
        let mut pair = self.normalised(if rounds == 0 { (1.0, 0.0) } else { (0.7, 0.5) });
        for _ in 0..rounds {
            let albedo = self.albedo(pair);
            pair = self.normalised(self.light_of(&albedo, pair));
        }
        let error = self.error(&self.albedo(pair), pair);
        let light = Light { ambient: [pair.0; 3], strength: [pair.1; 3], direction: self.direction };
        Solved { light, error }
    }

    fn shade(&self, i: usize, (ambient, strength): (f32, f32)) -> f32 {
        (ambient + strength * self.lamp[i]).max(MIN_SHADE)
    }

    /// `[F]`
    fn albedo(&self, pair: (f32, f32)) -> Vec<[f32; 3]> {
        let mut sums = vec![([0.0f32; 3], 0.0f32); self.n_faces];
        for (i, o) in self.observations.iter().enumerate() {
            let shade = self.shade(i, pair);
            let (top, bottom) = &mut sums[o.face as usize];
            (0..3).for_each(|k| top[k] += o.weight * o.colour[k] * shade);
            *bottom += o.weight * shade * shade;
        }
        sums.into_iter().map(|(top, bottom)| top.map(|t| if bottom > 0.0 { t / bottom } else { 0.0 })).collect()
    }

    /// Reweighted least squares for ambient light and strength, neither below zero.
    fn light_of(&self, albedo: &[[f32; 3]], pair: (f32, f32)) -> (f32, f32) {
        let (mut aa, mut ab, mut bb, mut ay, mut by) = (0.0f64, 0.0f64, 0.0f64, 0.0f64, 0.0f64);
        for (i, o) in self.observations.iter().enumerate() {
            let shade = self.shade(i, pair);
            for (albedo, colour) in albedo[o.face as usize].into_iter().zip(o.colour) {
                let weight = f64::from(o.weight / ((albedo * shade - colour).abs() + ROBUST));
                let (a, b, y) = (f64::from(albedo), f64::from(albedo * self.lamp[i]), f64::from(colour));
                aa += weight * a * a;
                ab += weight * a * b;
                bb += weight * b * b;
                ay += weight * a * y;
                by += weight * b * y;
            }
        }
        let determinant = aa * bb - ab * ab;
        let (ambient, strength) = if determinant > 1e-9 * aa * bb {
            ((ay * bb - by * ab) / determinant, (by * aa - ay * ab) / determinant)
        } else {
            (ay / aa.max(1e-12), 0.0)
        };
        match (ambient < 0.0, strength < 0.0) {
            (_, true) => ((ay / aa.max(1e-12)) as f32, 0.0),
            (true, false) => (0.0, (by / bb.max(1e-12)) as f32),
            _ => (ambient as f32, strength as f32),
        }
    }

    /// Scaled so that the mean shade is one: the albedo is then as bright as the person looked in the mean.
    fn normalised(&self, pair: (f32, f32)) -> (f32, f32) {
        let (mut sum, mut weights) = (0.0f64, 0.0f64);
        for (i, o) in self.observations.iter().enumerate() {
            sum += f64::from(o.weight * self.shade(i, pair));
            weights += f64::from(o.weight);
        }
        let mean = if weights > 0.0 { (sum / weights) as f32 } else { 1.0 };
        (pair.0 / mean, pair.1 / mean)
    }

    fn error(&self, albedo: &[[f32; 3]], pair: (f32, f32)) -> f64 {
        let (mut sum, mut weights) = (0.0f64, 0.0f64);
        for (i, o) in self.observations.iter().enumerate() {
            let shade = self.shade(i, pair);
            for (albedo, colour) in albedo[o.face as usize].into_iter().zip(o.colour) {
                sum += f64::from(o.weight * (albedo * shade - colour).abs());
            }
            weights += 3.0 * f64::from(o.weight);
        }
        sum / weights.max(1e-12)
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};

    use super::*;

    const UP: [f32; 3] = [0.0, -1.0, 0.0];
    const FORWARD: [f32; 3] = [0.0, 0.0, 1.0];

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
                    let shade = light.shade(normal);
                    let noise = 0.01 * (rng.random::<f32>() - 0.5);
                    let colour = std::array::from_fn(|k| albedo[k] * shade[k] + noise);
                    observations.push(Observation { face, weight: 4.0, colour, normal });
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
        let truth =
            Light { ambient: [0.6; 3], strength: [0.7, 0.6, 0.5], direction: direction(0.7, 35.0, UP, FORWARD) };
        let found = solve_light(&turning(&truth, 360.0), 400, UP, FORWARD);
        assert!(angle_deg(found.direction, truth.direction) < 15.0, "{found:?}");
        for k in 0..3 {
            let (ours, want) = (found.strength[k] / found.ambient[k], truth.strength[k] / truth.ambient[k]);
            assert!((ours / want - 1.0).abs() < 0.25, "channel {k}: {ours} instead of {want}");
        }
    }

    #[test]
    fn even_light_and_a_person_who_does_not_turn_show_no_lamp() {
        assert_eq!(solve_light(&turning(&Light::EVEN, 360.0), 400, UP, FORWARD), Light::EVEN);
        let lamp = Light { ambient: [0.6; 3], strength: [0.7; 3], direction: direction(0.7, 35.0, UP, FORWARD) };
        assert_eq!(solve_light(&turning(&lamp, 0.0), 400, UP, FORWARD), Light::EVEN);
        assert_eq!(solve_light(&[], 400, UP, FORWARD), Light::EVEN);
    }

    #[test]
    fn albedos_are_what_is_left_without_the_light() {
        let light = Light { ambient: [0.6; 3], strength: [0.7; 3], direction: direction(0.7, 35.0, UP, FORWARD) };
        let seen = turning(&light, 360.0);
        let (with, counts) = albedos(&seen, 401, &light);
        let (without, _) = albedos(&seen, 401, &Light::EVEN);
        let error = |colours: &[f32]| -> f32 {
            seen.iter().map(|o| (colours[3 * o.face as usize] * light.shade(o.normal)[0] - o.colour[0]).abs()).sum()
        };
        assert!(error(&with) < 0.1 * error(&without));
        assert_eq!((counts[400], with[1200]), (0.0, 0.0), "nobody saw the last face");
    }
}
