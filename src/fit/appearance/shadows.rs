//! What the light does not reach: the shadows that the fitted body casts on itself in each frame, and where it shuts itself in.

use rayon::prelude::*;

use crate::fit::poses::PoseGroups;
use crate::fit::scene::Scene;
use crate::gpu::GpuError;
use crate::ops::light::occlusion::openness;
use crate::ops::light::shadow::visibility;
use crate::ops::light::{Exposure, Light};

use super::Lit;

/// The body as posed in each frame, world space.
pub struct PosedClip<'a> {
    pub(super) faces: &'a [[u32; 3]],
    /// `[N][V]`
    pub(super) vertices: Vec<Vec<[f32; 3]>>,
}

impl<'a> PosedClip<'a> {
    pub fn new(faces: &'a [[u32; 3]]) -> Self {
        Self { faces, vertices: Vec::new() }
    }

    /// Adds the scene's body as it is posed now, the clip's next frame. Waits.
    pub fn push_posed(&mut self, scene: &Scene) -> Result<(), GpuError> {
        self.vertices.push(scene.gpu.read(&scene.posed.vertices)?.as_chunks().0.to_vec());
        Ok(())
    }

    pub fn n_frames(&self) -> usize {
        self.vertices.len()
    }

    /// What each vertex sees of a lamp in `direction`, `[frame][V]`, in the order of `frames`.
    pub fn visibility(&self, direction: [f32; 3], frames: &[usize]) -> Vec<Vec<f32>> {
        self.of_frames(frames, |vertices| visibility(direction, vertices, self.faces))
    }

    /// Which share of its surroundings each vertex sees in each frame, `[N][V]`.
    pub fn openness(&self) -> Vec<Vec<f32>> {
        let all: Vec<usize> = (0..self.n_frames()).collect();
        self.of_frames(&all, |vertices| openness(vertices, self.faces))
    }

    /// What of a light reaches each vertex in each frame, `[N][V]`.
    pub fn exposures(&self, light: &Light) -> Vec<Vec<Exposure>> {
        let all: Vec<usize> = (0..self.n_frames()).collect();
        self.of_frames(&all, |vertices| light.exposures(vertices, self.faces))
    }

    /// Frames side by side on all cores.
    fn of_frames<T: Send>(&self, frames: &[usize], of: impl Fn(&[[f32; 3]]) -> T + Sync) -> Vec<T> {
        frames.par_iter().map(|&frame| of(&self.vertices[frame])).collect()
    }
}

/// Finds what of `lit`'s light reaches the scene's shape in the poses as they are. Waits.
pub fn cast_shadows(scene: &Scene, faces: &[[u32; 3]], lit: &mut Lit, poses: &PoseGroups) -> Result<(), GpuError> {
    if !lit.light.has_lamp() && lit.light.occlusion == 0.0 {
        return Ok(());
    }
    let mut clip = PosedClip::new(faces);
    for frame in 0..scene.frames.len() {
        let mut recorder = scene.gpu.recorder("fit/cast_shadows");
        scene.skinning.pose_forward(&mut recorder, &scene.shape, poses.at(frame), &scene.posed);
        recorder.submit()?;
        clip.push_posed(scene)?;
    }
    lit.set(&scene.gpu, lit.light, &clip.exposures(&lit.light));
    Ok(())
}
