//! Host side of `shaders/bone_turns/`.

use std::sync::Arc;

use super::cpu::{Joints, orientations};
use super::quaternion::Quaternion;
use crate::body::{N_JOINTS, N_POSE};
use crate::gpu::{AnyBuffer, Buffer, Gpu, Kernel, Recorder, linear_groups};
use crate::ops::linear::Vector;

/// The turns of one clip's bones.
pub struct BoneTurns {
    forward: Arc<Kernel>,
    backward: Arc<Kernel>,
    /// `[24, 2]`
    skeleton: Buffer<u32>,
    /// `[N, 24, 3]`
    start: Buffer<f32>,
    /// `[N, 24, 4]`
    began: Buffer<[f32; 4]>,
    n_frames: usize,
}

impl BoneTurns {
    /// `start [N, 72]`
    ///
    /// # Panics
    /// When a length differs.
    pub fn new(gpu: &Gpu, joints: Joints<'_>, start: &[f32]) -> Self {
        let counts = (joints.parents.len(), joints.in_space.len(), start.len() % N_POSE);
        assert_eq!(counts, (N_JOINTS, N_JOINTS, 0), "joints");
        let joint = |(j, (&parent, &in_space)): (usize, (&i32, &bool))| {
            [u32::try_from(parent).unwrap_or(j as u32), u32::from(in_space)]
        };
        let skeleton: Vec<u32> = joints.parents.iter().zip(joints.in_space).enumerate().flat_map(joint).collect();
        let began = |pose: &[f32]| {
            let pose: Vec<Vector<f64>> = pose.as_chunks().0.iter().map(|w: &[f32; 3]| w.map(f64::from)).collect();
            let numbers = |q: Quaternion<f64>| [q.v[0], q.v[1], q.v[2], q.w].map(|x| x as f32);
            orientations(joints, &pose).into_iter().map(numbers).collect::<Vec<_>>()
        };
        Self {
            forward: kernel!(gpu, "bone_turns/forward"),
            backward: kernel!(gpu, "bone_turns/backward"),
            skeleton: gpu.upload("bone_turns/skeleton", &skeleton),
            start: gpu.upload("bone_turns/start", start),
            began: gpu.upload("bone_turns/began", &start.chunks_exact(N_POSE).flat_map(began).collect::<Vec<_>>()),
            n_frames: start.len() / N_POSE,
        }
    }

    /// Records `poses`.
    ///
    /// # Panics
    /// When a length differs.
    pub fn forward(&self, recorder: &mut Recorder<'_>, turns: &Buffer<f32>, poses: &Buffer<f32>) {
        self.check(&[turns, poses]);
        let buffers: &[&dyn AnyBuffer] = &[&self.skeleton, &self.start, &self.began, turns, poses];
        recorder.dispatch(&self.forward, &self.params(), buffers, linear_groups(self.n_frames, 8));
    }

    /// Records `grad_turns += ∂L/∂turns`; `poses` are those of `turns`.
    ///
    /// # Panics
    /// When a length differs.
    pub fn backward(
        &self,
        recorder: &mut Recorder<'_>,
        turns: &Buffer<f32>,
        poses: &Buffer<f32>,
        grad_poses: &Buffer<f32>,
        grad_turns: &Buffer<f32>,
    ) {
        self.check(&[turns, poses, grad_poses, grad_turns]);
        let buffers: &[&dyn AnyBuffer] = &[&self.skeleton, turns, poses, grad_poses, grad_turns];
        recorder.dispatch(&self.backward, &self.params(), buffers, linear_groups(self.n_frames, 8));
    }

    fn params(&self) -> [u32; 4] {
        [self.n_frames as u32, 0, 0, 0]
    }

    fn check(&self, buffers: &[&Buffer<f32>]) {
        for buffer in buffers {
            assert_eq!(buffer.len(), N_POSE * self.n_frames, "{}: length", buffer.label());
        }
    }
}
