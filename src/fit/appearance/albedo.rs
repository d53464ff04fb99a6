//! What the colours of faces in frames are made of: an albedo for each face, and the light on it, whose direction is given.

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

/// Residuals beyond this count linearly: wrong geometry is no light.
pub(super) const ROBUST: f32 = 0.05;

/// No part of a body is darker than this part of its mean look.
pub(super) const MIN_SHADE: f32 = 0.05;

/// From here on a camera shows everything brighter alike. What is brighter than such a colour does not contradict it.
pub(super) const WHITE: f32 = 0.97;

/// What makes up a shade, each with a weight of its own that is not below zero: ambient light from everywhere, from the camera's
/// side and from above ([`Light::slope`]), and the lamp.
const TERMS: usize = 4;

pub type Weights = [f32; TERMS];

/// Rounds in which it settles what is brighter than white.
const ALBEDO_ROUNDS: usize = 3;

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

/// `[F]`: least squares over the observations, each by what it counts, and over the channels of which `counts(colour, bright)` holds, `bright` by
/// the albedos `before`, which stand where none does. `shade(i)`: of observation i, a channel.
pub(super) fn mean_albedos(
    observations: &[Observation],
    n_faces: usize,
    weight: impl Fn(&Observation) -> f32,
    shade: impl Fn(usize) -> [f32; 3],
    counts: impl Fn(f32, f32) -> bool,
    before: &[[f32; 3]],
) -> Vec<[f32; 3]> {
    let mut sums = vec![([0.0f32; 3], [0.0f32; 3]); n_faces];
    let known = |face: usize| before.get(face).copied().unwrap_or_default();
    for (i, o) in observations.iter().enumerate() {
        let (shade, weight) = (shade(i), weight(o));
        let (top, bottom) = &mut sums[o.face as usize];
        for (k, albedo) in known(o.face as usize).into_iter().enumerate() {
            if counts(o.colour[k], albedo * shade[k]) {
                top[k] += weight * o.colour[k] * shade[k];
                bottom[k] += weight * shade[k] * shade[k];
            }
        }
    }
    let mean = |(face, (top, bottom)): (usize, ([f32; 3], [f32; 3]))| {
        let before = known(face);
        std::array::from_fn(|k| if bottom[k] > 0.0 { top[k] / bottom[k] } else { before[k] })
    };
    sums.into_iter().enumerate().map(mean).collect()
}

/// Albedos and the weights of the light for one direction of the lamp.
pub(super) struct Problem<'a> {
    observations: &'a [Observation],
    n_faces: usize,
    /// Of each observation
    terms: Vec<[f32; TERMS]>,
}

pub(super) struct Solved {
    pub weights: Weights,
    /// Mean absolute error a pixel and channel.
    pub error: f64,
}

/// Whether a channel of an observation says something about what would be `bright`.
pub(super) fn tells(colour: f32, bright: f32) -> bool {
    colour < WHITE || bright < colour
}

impl<'a> Problem<'a> {
    pub fn new(observations: &'a [Observation], n_faces: usize, terms: impl Fn(&Observation) -> [f32; TERMS]) -> Self {
        Self { observations, n_faces, terms: observations.iter().map(terms).collect() }
    }

    /// Alternates `rounds` times between the albedos and the light; no rounds are even light. The light is white: told a
    /// channel, it takes on the colours of what happens to face the lamp, and the dark side of grey trousers turns brown.
    pub fn solve(&self, rounds: usize) -> Solved {
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

    fn mean_albedo(&self, weights: Weights, counts: impl Fn(f32, f32) -> bool, before: &[[f32; 3]]) -> Vec<[f32; 3]> {
        let shade = |i: usize| [self.shade(i, weights); 3];
        mean_albedos(self.observations, self.n_faces, |o| o.weight, shade, counts, before)
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

/// Rounds of it: ambient light and what of it comes from one side are much alike.
const DESCENT_ROUNDS: usize = 400;

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::appearance::lamp::DARK;
    use crate::fit::appearance::testing::{lamp, sky, turning};

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
