//! Pose and placement of all frames: the paper's θᵢ, Rᵢ and tᵢ.

use std::ops::Range;

use super::FitError;
use super::checkpointed::{Checkpointed, Checkpointer};
use super::config::{FitConfig, Rates};
use super::groups::{Group, SmoothCoordinates};
use super::motion::{PLACE_JUMP, POSE_JUMP, frames_in};
use super::schedule::Step;
use super::state::FitState;
use crate::body::joints::{LEFT_HIP, PELVIS, RIGHT_HIP, SPINE1, SPINE2, SPINE3};
use crate::body::{Body, N_JOINTS, N_POSE};
use crate::gpu::{Buffer, Gpu, GpuError, Recorder};
use crate::ops::adam::{Adam, AdamConfig};
use crate::ops::bone_turns::{BoneTurns, Joints};
use crate::ops::skinning::PoseAt;
use crate::ops::tridiagonal::Tridiagonal;

/// Joints whose bones turn in space ([`crate::ops::bone_turns`]): each part of the trunk turns between neighbours that stay. Were knees and elbows
/// among them, which are held as hinges, arms would stray at the clip's ends (docs/lab/poses.md).
const IN_SPACE: [usize; 6] = [PELVIS, LEFT_HIP, RIGHT_HIP, SPINE1, SPINE2, SPINE3];

/// The parameters of all frames.
pub struct PoseGroups {
    pub poses: Poses,
    pub transl: Group,
    /// What the poses are moved by.
    turns: Group,
    bones: BoneTurns,
    /// Of poses and places, where all frames step together.
    smooth: Option<[SmoothInTime; 2]>,
}

/// Poses of all frames, which follow from turns ([`crate::ops::bone_turns`]), and the gradient of the losses by them.
pub struct Poses {
    /// `[N, 72]`
    pub values: Buffer<f32>,
    pub grads: Buffer<f32>,
}

impl PoseGroups {
    /// The parameters of `state`; steps begin where its stage began, and its frames are linked as they were then.
    pub fn new(gpu: &Gpu, config: &FitConfig, body: &Body, state: &FitState) -> Self {
        let adam = AdamConfig::default();
        let FitState { poses, stage_poses, transl, stage_transl, .. } = state;
        let frames = frames_in(config.pose_smoothing, stage_poses);
        let still = vec![0.0; stage_poses.len()];
        let smooth = || {
            let turns = SmoothInTime::new(gpu, &still, &links(stage_poses, N_JOINTS, POSE_JUMP), N_JOINTS, frames);
            [turns, SmoothInTime::new(gpu, stage_transl, &links(stage_transl, 1, PLACE_JUMP), 1, frames)]
        };
        let in_space: [bool; N_JOINTS] =
            std::array::from_fn(|joint| config.bones_in_space && IN_SPACE.contains(&joint));
        let joints = Joints { parents: &body.parents, in_space: &in_space };
        Self {
            poses: Poses { values: gpu.upload("fit/poses", poses), grads: gpu.zeros("fit/grad_poses", poses.len()) },
            turns: Group::per_frame(gpu, "turns", &still, N_POSE, adam),
            bones: BoneTurns::new(gpu, joints, stage_poses),
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
        recorder.clear(&self.poses.grads);
        self.transl.clear(recorder);
    }

    /// The weight, in a step that looks at `n` frames, of a term of every frame. A picture weighs 1 / n in it. Where a frame
    /// moves only in steps that look at it, the term weighs as much; where all frames move in each step, it comes more often.
    pub fn share_of_a_step(&self, n: usize) -> f32 {
        if self.smooth.is_some() { 1.0 / self.turns.n_frames() as f32 } else { 1.0 / n as f32 }
    }

    pub(super) fn step(&mut self, recorder: &mut Recorder<'_>, rates: &Rates, step: &Step<'_>) {
        let rate = step.rate * step.phase.pose_rate;
        let Self { poses, turns, bones, transl, smooth } = self;
        turns.clear(recorder);
        bones.backward(recorder, &turns.values, &poses.values, &poses.grads, &turns.grads);
        match smooth {
            Some([smooth_turns, smooth_transl]) => {
                smooth_turns.step(recorder, turns, rates.pose * rate);
                smooth_transl.step(recorder, transl, rates.transl * rate);
            }
            None => {
                turns.step(recorder, step.frames, rates.pose * rate);
                transl.step(recorder, step.frames, rates.transl * rate);
            }
        }
        bones.forward(recorder, &turns.values, &poses.values);
    }

    pub fn read_into(&self, gpu: &Gpu, state: &mut FitState) -> Result<(), GpuError> {
        state.poses = gpu.read(&self.poses.values)?;
        state.transl = self.transl.read(gpu)?;
        Ok(())
    }
}

impl Checkpointed for PoseGroups {
    fn checkpoint(&mut self, checkpointer: &mut Checkpointer<'_>, name: &str) -> Result<(), FitError> {
        checkpointer.buffer(&format!("{name}.poses"), &self.poses.values)?;
        let parts = [("turns", &mut self.turns), ("transl", &mut self.transl)];
        for (part, group) in parts {
            group.checkpoint(checkpointer, &format!("{name}.{part}"))?;
        }
        for (part, smooth) in ["turns", "transl"].iter().zip(self.smooth.iter_mut().flatten()) {
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
    /// `start [N, per_frame, 3]`. Steps spread over some `frames` frames where these are linked, `[N, per_frame]`.
    fn new(gpu: &Gpu, start: &[f32], linked: &[bool], per_frame: usize, frames: f32) -> Self {
        let beyond = (REACH * frames).ceil() as usize;
        let chain = prolonged(start, 3 * per_frame, beyond);
        let first = 3 * per_frame * beyond;
        let ends = vec![true; per_frame * beyond];
        let last = linked.len().saturating_sub(per_frame);
        let linked = [&ends, &linked[..last], &vec![true; linked.len() - last], &ends].concat();
        let solver = Tridiagonal::new(gpu, &linked, per_frame, f64::from(frames * frames));
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

/// `[N, per_frame]`: whether an entry of `values [N, per_frame, 3]` goes on in the next frame without changing by more than `jump`:
/// axis-angle vectors jump at half turns, and a gap in the clip is no motion.
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

    /// Angles between the orientations in space before and after one step down a gradient by the root's angles.
    fn turned_in_space(gpu: &Gpu, config: &FitConfig) -> [f64; N_JOINTS] {
        let body = Body::test_body();
        let mut pose = [0.1; N_POSE];
        pose[..3].copy_from_slice(&[3.0, 0.2, -0.1]);
        let state = FitState::new(&body, vec![0.0; body.n_betas], &[pose], &[[0.0; 3]], config.field, 1);
        let mut groups = PoseGroups::new(gpu, config, &body, &state);
        let mut gradient = [0.0; N_POSE];
        gradient[..3].copy_from_slice(&[0.3, -1.0, 0.5]);
        gpu.write(&groups.poses.grads, 0, &gradient);
        let phase = &config.geometry.phases[0];
        let mut recorder = gpu.recorder("fit/poses/test");
        groups.step(&mut recorder, &config.rates, &Step { phase, frames: &[0], trust: &[1.0], rate: 1.0, number: 1 });
        recorder.submit().unwrap();
        let orientations = |pose: &[f32]| {
            let mut all = [glam::DQuat::IDENTITY; N_JOINTS];
            for (j, w) in pose.as_chunks::<3>().0.iter().enumerate() {
                let above = usize::try_from(body.parents[j]).map_or(glam::DQuat::IDENTITY, |parent| all[parent]);
                all[j] = above * glam::DQuat::from_scaled_axis(w.map(f64::from).into());
            }
            all
        };
        let (before, after) = (orientations(&pose), orientations(&gpu.read(&groups.poses.values).unwrap()));
        std::array::from_fn(|j| before[j].angle_between(after[j]))
    }

    #[test]
    fn a_pelvis_turns_between_legs_and_a_chest_that_stay() {
        let Some(gpu) = gpu("fit::poses::a_pelvis_turns_between_legs_and_a_chest_that_stay") else { return };
        let [alone, whole] = [FitConfig::standard(1), FitConfig::paper(1)].map(|config| turned_in_space(&gpu, &config));
        assert!(alone[PELVIS] > 1e-3 && alone[1..].iter().all(|&angle| angle < 1e-5), "{alone:?}");
        assert!(whole.iter().all(|&angle| angle > 1e-3), "the paper's angles take all along: {whole:?}");
    }

    #[test]
    fn the_ends_of_a_clip_follow_a_slope_as_its_middle_does() {
        let Some(gpu) = gpu("fit::poses::the_ends_of_a_clip_follow_a_slope_as_its_middle_does") else { return };
        let n = 30;
        let wanted: Vec<f32> = (0..3 * n).map(|i| 0.01 * (i / 3) as f32 - 0.15).collect();
        let group = Group::per_frame(&gpu, "test", &vec![0.0; 3 * n], 3, AdamConfig::default());
        let mut chain = SmoothInTime::new(&gpu, &vec![0.0; 3 * n], &vec![true; n], 1, 4.0);
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
