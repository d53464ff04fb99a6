//! Where a point of one frame lies in the next: Lucas & Kanade 1981, coarse to fine (Bouguet 2001), inside the mask alone and
//! whatever the patch's mean brightness, which changes as it turns in the light.

use glam::{DMat2, DVec2};

use super::picture::{Level, Picture};

/// Sizes that a patch is looked for at.
pub const LEVELS: usize = 3;
const ITERATIONS: usize = 12;
/// Steps below this end the search, pixels.
const ENOUGH: f64 = 0.01;
/// Part of a patch that must lie inside the mask in both frames.
const LEAST_INSIDE: f64 = 0.6;
/// Least mean square of the slope along the patch's smoother direction, grey levels a pixel: below it the raster's noise decides.
const LEAST_SLOPE: f64 = 1.5;

/// Pixels of a patch at one place of one level: offset, brightness, slope.
struct Patch {
    samples: Vec<(DVec2, f64, DVec2)>,
}

/// Offsets of a square of `radius`.
fn square(radius: i32) -> impl Iterator<Item = DVec2> {
    (-radius..=radius).flat_map(move |y| (-radius..=radius).map(move |x| DVec2::new(x.into(), y.into())))
}

impl Patch {
    /// `None` where too little of it lies inside.
    fn new(level: &Level, centre: DVec2, radius: i32) -> Option<Self> {
        let sample = |offset: DVec2| (offset, level.at(centre + offset), level.slope(centre + offset));
        let samples: Vec<_> = square(radius).filter(|offset| level.is_inside(centre + *offset)).map(sample).collect();
        enough(samples.len(), radius).then_some(Self { samples })
    }
}

fn enough(samples: usize, radius: i32) -> bool {
    samples as f64 >= LEAST_INSIDE * f64::from((2 * radius + 1).pow(2))
}

/// `Σ (s − s̄)(s − s̄)ᵀ` over slopes.
fn structure(slopes: &[DVec2]) -> DMat2 {
    let mean = slopes.iter().sum::<DVec2>() / slopes.len().max(1) as f64;
    slopes.iter().fold(DMat2::ZERO, |sum, s| {
        let d = *s - mean;
        sum + DMat2::from_cols(d * d.x, d * d.y)
    })
}

/// The smaller eigenvalue of a symmetric matrix.
fn smaller_eigenvalue(m: DMat2) -> f64 {
    let (mean, half) = (0.5 * (m.x_axis.x + m.y_axis.y), 0.5 * (m.x_axis.x - m.y_axis.y));
    mean - half.hypot(m.x_axis.y)
}

/// How well a patch can be found again (Shi & Tomasi 1994): the root mean square slope along its smoother direction, grey
/// levels a pixel; 0 where it cannot.
pub fn texture(level: &Level, centre: DVec2, radius: i32) -> f64 {
    let Some(patch) = Patch::new(level, centre, radius) else { return 0.0 };
    let slopes: Vec<DVec2> = patch.samples.iter().map(|s| s.2).collect();
    let rms = (smaller_eigenvalue(structure(&slopes)).max(0.0) / slopes.len() as f64).sqrt();
    if rms >= LEAST_SLOPE { rms } else { 0.0 }
}

/// Where the point `at` (image pixels) of `from` lies in `to`.
pub fn follow(from: &Picture, to: &Picture, at: DVec2, radius: i32) -> Option<DVec2> {
    let mut moved = DVec2::ZERO;
    for (n, (here, there)) in from.levels.iter().zip(&to.levels).enumerate().rev() {
        let scale = f64::from(1 << n as i32).recip();
        let refined = Patch::new(here, (at - from.origin) * scale, radius)
            .and_then(|patch| register(&patch, there, (at + moved - to.origin) * scale, radius))
            .map(|found| found / scale + to.origin - at);
        match refined {
            Some(found) => moved = found,
            // At a small size a patch may lie across the outline.
            None if n > 0 => {}
            None => return None,
        }
    }
    Some(at + moved)
}

/// Where a patch lies on a level, near `start`.
fn register(patch: &Patch, level: &Level, start: DVec2, radius: i32) -> Option<DVec2> {
    let mut centre = start;
    for _ in 0..ITERATIONS {
        let seen: Vec<(f64, DVec2)> = patch
            .samples
            .iter()
            .filter(|(offset, ..)| level.is_inside(centre + *offset))
            .map(|(offset, grey, slope)| (grey - level.at(centre + *offset), *slope))
            .collect();
        if !enough(seen.len(), radius) {
            return None;
        }
        let n = seen.len() as f64;
        let brighter = seen.iter().map(|(d, _)| d).sum::<f64>() / n;
        let mean = seen.iter().map(|(_, s)| *s).sum::<DVec2>() / n;
        let slopes: Vec<DVec2> = seen.iter().map(|(_, s)| *s).collect();
        let information = structure(&slopes);
        if (smaller_eigenvalue(information).max(0.0) / n).sqrt() < LEAST_SLOPE {
            return None;
        }
        let rhs: DVec2 = seen.iter().map(|(d, s)| (*s - mean) * (d - brighter)).sum();
        let step = information.inverse() * rhs;
        if !step.is_finite() || step.length() > f64::from(2 * radius) {
            return None;
        }
        centre += step;
        if step.length() < ENOUGH {
            break;
        }
    }
    Some(centre)
}
