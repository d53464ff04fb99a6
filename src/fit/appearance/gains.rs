//! What the camera has changed from frame to frame: exposure and white balance, a factor a channel. The light stands still and albedos
//! are the person's, so what is common to all faces of a frame is the camera's.

use super::Lit;
use super::albedo::{MIN_SHADE, Observation, ROBUST, WHITE, mean_albedos, tells};
use super::lamp::{of_face, solve_light};
use super::mean_colours::{observe, sky, solve};
use super::shadows::PosedClip;
use crate::fit::poses::PoseGroups;
use crate::fit::scene::Scene;
use crate::gpu::GpuError;
use crate::ops::light::{Exposure, Light};

/// The error without gains has to be larger than with them by this factor, else the camera changed nothing. Clips of a camera that
/// changed nothing have up to 1.01 under a lamp with its shadows and 1.04 without (docs/lab/light.md, "A camera that follows the scene").
const MIN_GAIN: f64 = 1.05;
/// How often light and gains are found anew: a drift over the whole turn first looks like a lamp.
const LIGHTS: usize = 3;
/// No camera changes more; a frame that somebody's thumb covers shall not make all others bright.
const MOST: f32 = 3.0;
/// Rounds of alternation between albedos and gains.
const ROUNDS: usize = 20;

/// Exposure and white balance of each frame.
struct Solved {
    /// `[N]`; the geometric mean over the frames is one
    gains: Vec<[f32; 3]>,
    /// Mean absolute error a pixel and channel without gains, and with them.
    errors: [f64; 2],
}

/// By what factor each frame's channels are brighter than in the mean, for the scene's shape and poses; `None` where they are not told
/// to differ. Waits.
pub fn solve_gains(
    scene: &Scene,
    faces: &[[u32; 3]],
    poses: &PoseGroups,
    level: usize,
) -> Result<Option<Vec<[f32; 3]>>, GpuError> {
    let n_frames = scene.frames.len();
    let lit = Lit::new(&scene.gpu, faces, &scene.topology, n_frames, Light::EVEN);
    let mut clip = PosedClip::new(faces);
    let observations = observe(scene, faces.len(), Some(&lit), poses, level, &mut clip)?;
    let found = |light: &Light, exposures: &[Vec<Exposure>]| {
        let shade = |o: &Observation| {
            let reaching = exposures.get(o.frame as usize).map(|of| of_face(of, faces[o.face as usize]));
            // White, as the solved lights are.
            light.shade(o.normal, reaching.unwrap_or(Exposure::FULL))[0].max(MIN_SHADE)
        };
        let shades: Vec<f32> = observations.iter().map(shade).collect();
        let solved = gains_of(&observations, &shades, faces.len(), n_frames);
        tracing::debug!(errors = ?solved.errors, shadows = !exposures.is_empty(), "exposure and white balance");
        solved
    };
    // Shadows take long, and where nothing changes that mostly shows without them.
    if !found(&solve_light(&observations, faces.len(), &sky(scene, level)), &[]).differ() {
        return Ok(None);
    }
    let mut gains = vec![[1.0; 3]; n_frames];
    for round in 0..LIGHTS {
        let evened: Vec<Observation> = observations.iter().map(|o| evened(o, gains[o.frame as usize])).collect();
        let (light, exposures) = solve(scene, faces, &evened, level, &clip);
        let solved = found(&light, &exposures);
        if round == 0 && !solved.differ() {
            return Ok(None);
        }
        gains = solved.gains;
    }
    Ok(Some(gains))
}

impl Solved {
    /// Whether the frames are told to differ.
    fn differ(&self) -> bool {
        let [without, with] = self.errors;
        without > MIN_GAIN * with
    }
}

/// As a camera would have seen it that changes nothing. White says at least so much, whatever the gain.
fn evened(o: &Observation, gain: [f32; 3]) -> Observation {
    let colour = std::array::from_fn(|k| if o.colour[k] < WHITE { o.colour[k] / gain[k] } else { o.colour[k] });
    Observation { colour, ..*o }
}

/// Albedos and gains in turns, by pixels well inside the masks, where the observations were shaded by `shades`.
fn gains_of(observations: &[Observation], shades: &[f32], n_faces: usize, n_frames: usize) -> Solved {
    let mut gains = vec![[1.0f32; 3]; n_frames];
    let albedos_of = |gains: &[[f32; 3]], counts: fn(f32, f32) -> bool, before: &[[f32; 3]]| {
        let shade = |i: usize| gains[observations[i].frame as usize].map(|gain| gain * shades[i]);
        mean_albedos(observations, n_faces, |o| o.inside, shade, counts, before)
    };
    let mut albedos = albedos_of(&gains, |colour, _| colour < WHITE, &[]);
    let mut errors = [0.0; 2];
    for round in 0..=ROUNDS {
        albedos = albedos_of(&gains, tells, &albedos);
        let (next, error) = next_gains(observations, shades, &albedos, &gains);
        errors[usize::from(round > 0)] = error;
        if round < ROUNDS {
            gains = next;
        }
    }
    Solved { gains, errors }
}

/// Reweighted least squares for the gains, from `gains` on, and the mean absolute error with those. A frame that shows nothing keeps its own.
fn next_gains(
    observations: &[Observation],
    shades: &[f32],
    albedos: &[[f32; 3]],
    gains: &[[f32; 3]],
) -> (Vec<[f32; 3]>, f64) {
    let mut sums = vec![[[0.0f64; 2]; 3]; gains.len()];
    let (mut error, mut pixels) = (0.0f64, 0.0f64);
    for (o, shade) in observations.iter().zip(shades) {
        let frame = o.frame as usize;
        for (k, [top, bottom]) in sums[frame].iter_mut().enumerate() {
            let bright = albedos[o.face as usize][k] * shade;
            if !tells(o.colour[k], bright * gains[frame][k]) {
                continue;
            }
            let off = (bright * gains[frame][k] - o.colour[k]).abs();
            error += f64::from(o.inside * off);
            pixels += f64::from(o.inside);
            let weight = o.inside / (off + ROBUST);
            *top += f64::from(weight * o.colour[k] * bright);
            *bottom += f64::from(weight * bright * bright);
        }
    }
    let next = |(sums, gains): (&[[f64; 2]; 3], &[f32; 3])| {
        let of = |k: usize| ((sums[k][0] / sums[k][1]) as f32).clamp(1.0 / MOST, MOST);
        std::array::from_fn(|k| if sums[k].iter().all(|&sum| sum > 0.0) { of(k) } else { gains[k] })
    };
    let mut next: Vec<[f32; 3]> = sums.iter().zip(gains).map(next).collect();
    for k in 0..3 {
        let mean = (next.iter().map(|gain| f64::from(gain[k]).ln()).sum::<f64>() / next.len() as f64).exp();
        next.iter_mut().for_each(|gain| gain[k] /= mean as f32);
    }
    (next, error / pixels.max(1e-12))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::appearance::testing::{lamp, turning};

    const FRAMES: usize = 40;

    /// What is found of a turn whose frame k was filmed with `gain(k)`.
    fn found(gain: impl Fn(usize) -> [f32; 3]) -> Solved {
        let light = lamp(0.7, 35.0);
        let mut seen = turning(&light, 360.0);
        let shades: Vec<f32> = seen.iter().map(|o| light.shade(o.normal, Exposure::FULL)[0]).collect();
        for o in &mut seen {
            let gain = gain(o.frame as usize);
            o.colour = std::array::from_fn(|k| (gain[k] * o.colour[k]).min(1.0));
        }
        gains_of(&seen, &shades, 400, FRAMES)
    }

    #[test]
    fn a_camera_that_stands_still_is_told_apart_from_one_that_follows_the_scene() {
        let still = found(|_| [1.0; 3]);
        assert!(still.errors[0] < 1.02 * still.errors[1], "{:?}", still.errors);
        assert!(still.gains.as_flattened().iter().all(|gain| (gain - 1.0).abs() < 0.01), "{:?}", still.gains);
        // Exposure goes up and down, and red and blue against each other; bright skin is cut off at white meanwhile.
        let gain = |k: usize| {
            let (slow, slower) = ((0.4 * k as f32).sin(), (0.15 * k as f32).sin());
            [1.0 + 0.05 * slower, 1.0, 1.0 - 0.05 * slower].map(|of| of * (1.0 + 0.2 * slow))
        };
        let found = found(gain);
        assert!(found.errors[0] > 3.0 * found.errors[1], "{:?}", found.errors);
        for c in 0..3 {
            let mean = ((0..FRAMES).map(|k| gain(k)[c].ln()).sum::<f32>() / FRAMES as f32).exp();
            for (k, ours) in found.gains.iter().enumerate() {
                let want = gain(k)[c] / mean;
                assert!((ours[c] / want - 1.0).abs() < 0.01, "frame {k}, channel {c}: {} instead of {want}", ours[c]);
            }
        }
    }

    #[test]
    fn a_frame_that_shows_nothing_is_as_it_is() {
        let light = lamp(0.7, 35.0);
        let seen: Vec<Observation> = turning(&light, 360.0).into_iter().filter(|o| o.frame != 7).collect();
        let solved = gains_of(&seen, &vec![1.0; seen.len()], 400, FRAMES);
        assert!(solved.gains.as_flattened().iter().all(|gain| gain.is_finite() && *gain > 0.5), "{:?}", solved.gains);
        // Nor does one that is all but black tell what the camera did in the others.
        let covered = found(|k| [if k == 7 { 0.02 } else { 1.0 }; 3]);
        for (k, gain) in covered.gains.iter().enumerate().filter(|(k, _)| *k != 7) {
            assert!((gain[0] - 1.0).abs() < 0.04, "frame {k}: {gain:?}");
        }
        assert!(covered.gains[7][0] > 0.3, "{:?}", covered.gains[7]);
        let none = gains_of(&[], &[], 400, 3);
        assert_eq!(none.gains, [[1.0; 3]; 3]);
    }
}
