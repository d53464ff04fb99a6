//! People drawn at random: the adults from which the shape space is made.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::macros::{Params, RACES};
use crate::math::normal;

/// What the macro axes tie to each other varies by itself in people: lengths of limbs and trunk, breadths, girths.
/// Pairs of targets (`…-decr`, `…-incr`) and the deviation of their weight; a weight of 0.1 is 5–10 mm of length.
const DETAILS: [(&str, f64); 10] = [
    ("arms/measure-upperarm-length", 0.15),
    ("arms/measure-lowerarm-length", 0.15),
    ("legs/measure-upperleg-height", 0.12),
    ("legs/measure-lowerleg-height", 0.12),
    ("torso/torso-scale-vert", 0.12),
    ("torso/torso-scale-horiz", 0.2),
    ("hip/hip-scale-horiz", 0.25),
    ("torso/measure-waist-circ", 0.4),
    ("stomach/stomach-tone", 0.3),
    ("neck/neck-scale-vert", 0.2),
];

/// Draws people one after another, the same ones for the same seed.
pub(super) struct Population {
    rng: Pcg64,
}

impl Population {
    pub(super) fn new(seed: u64) -> Self {
        Self { rng: Pcg64::seed_from_u64(seed) }
    }

    fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.rng.random::<f64>()
    }

    /// A normal value, cut to the axes' range 0..1.
    fn normal(&mut self, mean: f64, deviation: f64) -> f64 {
        (mean + deviation * normal(&mut self.rng)).clamp(0.0, 1.0)
    }

    /// An adult: mostly clearly a woman or a man, half of them young, slim to heavy, short to tall, of mixed descent.
    pub(super) fn adult(&mut self) -> Params {
        let gender = match self.rng.random_range(0..10) {
            0..5 => self.uniform(0.0, 0.15),
            5..9 => self.uniform(0.85, 1.0),
            _ => self.uniform(0.15, 0.85),
        };
        let age = if self.rng.random_bool(0.5) { self.uniform(0.42, 0.6) } else { self.uniform(0.5, 0.9) };
        let races = std::array::from_fn::<f64, { RACES.len() }, _>(|_| self.uniform(0.02, 1.0).powi(3));
        let sum: f64 = races.iter().sum();
        let details = DETAILS.map(|(target, deviation)| {
            let weight = (deviation * normal(&mut self.rng)).clamp(-1.0, 1.0);
            (format!("{target}-{}", if weight < 0.0 { "decr" } else { "incr" }), weight.abs())
        });
        Params {
            gender,
            age,
            muscle: self.normal(0.5, 0.2),
            weight: self.normal(0.55, 0.22),
            height: self.normal(0.5, 0.085),
            proportions: self.normal(0.5, 0.2),
            cupsize: self.normal(0.5, 0.2),
            firmness: self.normal(0.5, 0.2),
            races: races.map(|share| share / sum),
            details: details.into(),
        }
    }
}
