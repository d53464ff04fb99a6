//! Pose and placement of all frames: the paper's θᵢ, Rᵢ and tᵢ.

use std::ops::Range;

use super::FitError;
use super::checkpointed::{Checkpointed, Checkpointer};
use super::config::{FitConfig, Rates};
use super::groups::{Group, SmoothCoordinates};
use super::motion::{PLACE_JUMP, POSE_JUMP, frames_in};
use super::schedule::Step;
use super::state::FitState;
use crate::body::{N_JOINTS, N_POSE};
use crate::gpu::{Buffer, Gpu, GpuError, Recorder};
use crate::ops::adam::{Adam, AdamConfig};
use crate::ops::skinning::PoseAt;
use crate::ops::tridiagonal::Tridiagonal;

/// The parameters of all frames.
pub struct PoseGroups {
    pub poses: Group,
    pub transl: Group,
    /// Of poses and places, where all frames step together.
    smooth: Option<[SmoothInTime; 2]>,
}

impl PoseGroups {
    /// The parameters of `state`, whose frames are linked as they were when the stage began.
    pub fn new(gpu: &Gpu, config: &FitConfig, state: &FitState) -> Self {
        let adam = AdamConfig::default();
        let (poses, transl) = (&state.poses, &state.transl);
        let frames = frames_in(config.pose_smoothing, &state.stage_poses);
        let smooth = || {
            let of = |start: &[f32], per_frame, jump| SmoothInTime::new(gpu, start, per_frame, jump, frames);
            [of(&state.stage_poses, N_JOINTS, POSE_JUMP), of(&state.stage_transl, 1, PLACE_JUMP)]
        };
        Self {
            poses: Group::per_frame(gpu, "poses", poses, N_POSE, adam),
            transl: Group::per_frame(gpu, "transl", transl, 3, adam),
            smooth: (frames > 0.0).then(smooth),
        }
    }

    pub fn at(&self, frame: usize) -> PoseAt<'_> {
        PoseAt { poses: &self.poses.values, transl: &self.transl.values, frame }
    }

    pub fn grad_at(&self, frame: usize) -> PoseAt<'_> {
        PoseAt { poses: &self.poses.grads, transl: &self.transl.grads, frame }
    }

    pub fn clear(&self, recorder: &mut Recorder<'_>) {
        self.poses.clear(recorder);
        self.transl.clear(recorder);
    }

    /// The weight, in a step that looks at `n` frames, of a term of every frame. A picture weighs 1 / n in it. Where a frame
    /// moves only in steps that look at it, the term weighs as much; where all frames move in each step, it comes more often.
    pub fn share_of_a_step(&self, n: usize) -> f32 {
        if self.smooth.is_some() { 1.0 / self.poses.n_frames() as f32 } else { 1.0 / n as f32 }
    }

    pub(super) fn step(&mut self, recorder: &mut Recorder<'_>, rates: &Rates, step: &Step<'_>) {
        let rate = step.rate * step.phase.pose_rate;
        let Self { poses, transl, smooth } = self;
        match smooth {
            Some([smooth_poses, smooth_transl]) => {
                smooth_poses.step(recorder, poses, rates.pose * rate);
                smooth_transl.step(recorder, transl, rates.transl * rate);
            }
            None => {
                poses.step(recorder, step.frames, rates.pose * rate);
                transl.step(recorder, step.frames, rates.transl * rate);
            }
        }
    }

    pub fn read_into(&self, gpu: &Gpu, state: &mut FitState) -> Result<(), GpuError> {
        state.poses = self.poses.read(gpu)?;
        state.transl = self.transl.read(gpu)?;
        Ok(())
    }
}

impl Checkpointed for PoseGroups {
    fn checkpoint(&mut self, checkpointer: &mut Checkpointer<'_>, name: &str) -> Result<(), FitError> {
        let parts = [("poses", &mut self.poses), ("transl", &mut self.transl)];
        for (part, group) in parts {
            group.checkpoint(checkpointer, &format!("{name}.{part}"))?;
        }
        for (part, smooth) in ["poses", "transl"].iter().zip(self.smooth.iter_mut().flatten()) {
            smooth.checkpoint(checkpointer, &format!("{name}.{part}.smooth"))?;
        }
        Ok(())
    }
}

/// Large steps ([`crate::ops::large_steps`]) along time: the frames are a chain. Where a body leans or how it faces is told by
/// small differences that neighbouring frames share, while what pixels say of one frame alone is mostly their own raster.
/// Spread over its neighbours, a frame's gradient keeps the former and loses the latter.
///
/// A chain that ends lets what it spreads have no slope there: the clip's first and last frames would follow their neighbours
/// whatever they show. So the chain goes on beyond the clip, by frames that no picture sees.
struct SmoothInTime {
    smooth: SmoothCoordinates<Tridiagonal>,
    adam: Adam,
    steps: u32,
    /// The clip's numbers within the chain's.
    clip: Range<usize>,
    values: Buffer<f32>,
    /// Zero beyond the clip.
    grads: Buffer<f32>,
}

impl SmoothInTime {
    /// `start [N, per_frame, 3]`. Steps spread over some `frames` frames, but not where a number changes by more than `jump`:
    /// axis-angle vectors jump at half turns, and a gap in the clip is no motion.
    fn new(gpu: &Gpu, start: &[f32], per_frame: usize, jump: f32, frames: f32) -> Self {
        let beyond = (REACH * frames).ceil() as usize;
        let chain = prolonged(start, 3 * per_frame, beyond);
        let first = 3 * per_frame * beyond;
        let solver = Tridiagonal::new(gpu, &links(&chain, per_frame, jump), per_frame, f64::from(frames * frames));
        Self {
            smooth: SmoothCoordinates::new(gpu, solver, &chain),
            adam: Adam::new(gpu, "smooth_in_time", chain.len(), AdamConfig::default()),
            steps: 0,
            clip: first..first + start.len(),
            values: gpu.zeros("fit/smooth/chain", chain.len()),
            grads: gpu.zeros("fit/smooth/grad_chain", chain.len()),
        }
    }

    fn step(&mut self, recorder: &mut Recorder<'_>, group: &Group, rate: f32) {
        self.steps += 1;
        let (adam, number) = (&self.adam, self.steps);
        let Group { values, grads, .. } = group;
        recorder.copy(grads, 0..grads.len(), &self.grads, self.clip.start);
        self.smooth.step(recorder, &self.values, &self.grads, |recorder, u: &Buffer<f32>, grad_u| {
            adam.step(recorder, u, grad_u, 0..u.len(), rate, number);
        });
        recorder.copy(&self.values, self.clip.clone(), values, 0);
    }
}

impl Checkpointed for SmoothInTime {
    fn checkpoint(&mut self, checkpointer: &mut Checkpointer<'_>, name: &str) -> Result<(), FitError> {
        self.smooth.checkpoint(checkpointer, name)?;
        checkpointer.counts(&format!("{name}.steps"), std::slice::from_mut(&mut self.steps))?;
        self.adam.checkpoint(checkpointer, name)
    }
}

/// How far the chain goes on beyond the clip, in the frames that steps are spread over: there e⁻³ of a step are left.
const REACH: f32 = 3.0;

/// `values [N, stride]` with `beyond` more frames at either end, equal to the last one there.
fn prolonged(values: &[f32], stride: usize, beyond: usize) -> Vec<f32> {
    let frames: Vec<&[f32]> = values.chunks_exact(stride).collect();
    let (Some(first), Some(last)) = (frames.first(), frames.last()) else { return Vec::new() };
    let ends = |end: &[f32]| end.repeat(beyond);
    [ends(first), values.to_vec(), ends(last)].concat()
}

/// `[N, per_frame]`: whether an entry of `values [N, per_frame, 3]` goes on in the next frame without a jump.
fn links(values: &[f32], per_frame: usize, jump: f32) -> Vec<bool> {
    let entries = values.as_chunks::<3>().0;
    let near = |a: &[f32; 3], b: &[f32; 3]| a.iter().zip(b).all(|(x, y)| (x - y).abs() <= jump);
    let next = |i: usize| entries.get(i + per_frame).is_some_and(|after| near(&entries[i], after));
    (0..entries.len()).map(next).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ops::testing::gpu;

    #[test]
    fn frames_are_linked_joint_by_joint_but_not_over_a_jump() {
        // Four frames of two joints; the second one jumps before the last frame.
        let mut values = vec![0.0; 24];
        values[21] = 3.0;
        let links = links(&values, 2, 0.5);
        assert_eq!(links, [true, true, true, true, true, false, false, false]);
    }

    #[test]
    fn the_chain_goes_on_beyond_the_clip() {
        assert_eq!(
            prolonged(&[1.0, 2.0, 3.0, 4.0], 2, 2),
            [1.0, 2.0, 1.0, 2.0, 1.0, 2.0, 3.0, 4.0, 3.0, 4.0, 3.0, 4.0]
        );
        assert_eq!(prolonged(&[1.0, 2.0], 2, 0), [1.0, 2.0]);
    }

    #[test]
    fn the_ends_of_a_clip_follow_a_slope_as_its_middle_does() {
        let Some(gpu) = gpu("fit::poses::the_ends_of_a_clip_follow_a_slope_as_its_middle_does") else { return };
        let n = 30;
        let wanted: Vec<f32> = (0..3 * n).map(|i| 0.01 * (i / 3) as f32 - 0.15).collect();
        let group = Group::per_frame(&gpu, "test", &vec![0.0; 3 * n], 3, AdamConfig::default());
        let mut chain = SmoothInTime::new(&gpu, &vec![0.0; 3 * n], 1, 1.0, 4.0);
        let mut off = vec![0.0; 3 * n];
        for step in 0..150 {
            let values = group.read(&gpu).unwrap();
            off = values.iter().zip(&wanted).map(|(x, w)| x - w).collect();
            gpu.write(&group.grads, 0, &off);
            let mut recorder = gpu.recorder("fit/poses/test");
            chain.step(&mut recorder, &group, 1e-2 * 0.98f32.powi(step));
            recorder.submit().unwrap();
        }
        let most =
            |frames: Range<usize>| off[3 * frames.start..3 * frames.end].iter().fold(0.0f32, |m, x| m.max(x.abs()));
        let (first, middle, last) = (most(0..2), most(8..22), most(n - 2..n));
        // A chain that ends with the clip leaves 0.011 and 0.010, and 0.002 in the middle.
        assert!(first < 0.007 && last < 0.007 && middle < 0.003, "{first} and {last}, in the middle {middle}");
    }
}
