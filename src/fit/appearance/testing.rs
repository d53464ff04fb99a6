//! Light for tests, and a person who turns in it.

use rand::{RngExt, SeedableRng};

use super::albedo::Observation;
use super::lamp::OCCLUSION;
use super::sky::Sky;
use crate::ops::light::{Exposure, Light};

pub fn sky() -> Sky {
    Sky::new([0.0, -1.0, 0.0], [0.0, 0.0, 1.0])
}

pub fn lamp(azimuth: f64, elevation_deg: f64) -> Light {
    let direction = sky().direction(azimuth, elevation_deg);
    Light { ambient: [0.6; 3], strength: [0.7; 3], direction, occlusion: OCCLUSION, slope: [0.0; 3] }
}

/// Faces of a turning person of random colours, each seen while it looks at the camera.
pub fn turning(light: &Light, turn_deg: f32) -> Vec<Observation> {
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
