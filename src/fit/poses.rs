//! Pose and placement of all frames: the paper's θᵢ, Rᵢ and tᵢ.

use super::config::{FitConfig, Rates};
use super::groups::{Group, SmoothCoordinates};
use super::motion::{PLACE_JUMP, POSE_JUMP};
use super::schedule::Step;
use super::state::FitState;
use crate::body::N_JOINTS;
use crate::gpu::{Buffer, Gpu, GpuError, Recorder};
use crate::ops::adam::{Adam, AdamConfig};
use crate::ops::large_steps::LargeSteps;
use crate::ops::skinning::PoseAt;

/// The parameters of all frames.
pub struct PoseGroups {
    pub poses: Group,
    pub transl: Group,
    /// Of poses and places, where all frames step together.
    smooth: Option<[SmoothInTime; 2]>,
}

impl PoseGroups {
    pub fn new(gpu: &Gpu, config: &FitConfig, state: &FitState) -> Self {
        let adam = AdamConfig::default();
        let (poses, transl) = (&state.poses, &state.transl);
        let frames = config.pose_smoothing * state.n_frames() as f32;
        let smooth = || {
            let of = |start: &[f32], per_frame, jump| SmoothInTime::new(gpu, start, per_frame, jump, frames);
            [of(poses, N_JOINTS, POSE_JUMP), of(transl, 1, PLACE_JUMP)]
        };
        Self {
            poses: Group::per_frame(gpu, "poses", poses, 3 * N_JOINTS, adam),
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

/// Large steps ([`crate::ops::large_steps`]) along time: the frames are a chain. Where a body leans or how it faces is told by
/// small differences that neighbouring frames share, while what pixels say of one frame alone is mostly their own raster.
/// Spread over its neighbours, a frame's gradient keeps the former and loses the latter.
struct SmoothInTime {
    smooth: SmoothCoordinates,
    adam: Adam,
    steps: u32,
}

impl SmoothInTime {
    /// `start [N, per_frame, 3]`. Steps spread over some `frames` frames, but not where a number changes by more than `jump`:
    /// axis-angle vectors jump at half turns, and a gap in the clip is no motion.
    fn new(gpu: &Gpu, start: &[f32], per_frame: usize, jump: f32, frames: f32) -> Self {
        let (starts, items) = chains(start, per_frame, jump);
        let solver = LargeSteps::new(gpu, &starts, &items, f64::from(frames * frames));
        let adam = Adam::new(gpu, "smooth_in_time", start.len(), AdamConfig::default());
        Self { smooth: SmoothCoordinates::new(gpu, solver, start), adam, steps: 0 }
    }

    fn step(&mut self, recorder: &mut Recorder<'_>, group: &Group, rate: f32) {
        self.steps += 1;
        let (adam, number) = (&self.adam, self.steps);
        let Group { values, grads, .. } = group;
        self.smooth.step(recorder, values, grads, |recorder, u: &Buffer<f32>, grad_u| {
            adam.step(recorder, u, grad_u, 0..u.len(), rate, number);
        });
    }
}

/// The frames before and after each entry of `values [N, per_frame, 3]`, as compressed rows.
fn chains(values: &[f32], per_frame: usize, jump: f32) -> (Vec<u32>, Vec<u32>) {
    let entries = values.as_chunks::<3>().0;
    let linked = |a: usize, b: usize| entries[a].iter().zip(&entries[b]).all(|(x, y)| (x - y).abs() <= jump);
    let (mut starts, mut items) = (vec![0], Vec::new());
    for i in 0..entries.len() {
        let (before, after) = (i.checked_sub(per_frame), Some(i + per_frame).filter(|&k| k < entries.len()));
        items.extend([before, after].into_iter().flatten().filter(|&k| linked(i, k)).map(|k| k as u32));
        starts.push(items.len() as u32);
    }
    (starts, items)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_linked_joint_by_joint_but_not_over_a_jump() {
        // Four frames of two joints; the second one jumps before the last frame.
        let mut values = vec![0.0; 24];
        values[21] = 3.0;
        let (starts, items) = chains(&values, 2, 0.5);
        let row = |i: usize| &items[starts[i] as usize..starts[i + 1] as usize];
        assert_eq!([row(0), row(2), row(4), row(6)], [&[2][..], &[0, 4], &[2, 6], &[4]]);
        assert_eq!([row(1), row(3), row(5), row(7)], [&[3][..], &[1, 5], &[3], &[]]);
    }
}
