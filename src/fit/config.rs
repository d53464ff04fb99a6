//! The numbers of a fit: weights, learning rates, schedules, presets.

use super::stage0::Trust;
use crate::ops::soft_rasterize::SoftRasterizeParams;
use crate::ops::texture_field::TextureFieldConfig;

/// How the silhouette moves the mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SilhouetteGradient {
    /// NMR's scanline sweeps over the hard silhouette (the paper's choice).
    Nmr,
    /// The derivative of what crosses the pixels' borders (Pidhorskyi et al. 2024).
    Edge,
}

/// Weights λ of the losses of a stage. Image sums are divided by the frame's foreground pixels first, keypoints by their
/// number and the square of a hundredth of the image side, mesh sums by the number of faces: one set serves all
/// resolutions. A term of weight zero is not computed.
#[derive(Default, Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Weights {
    /// On the hard image.
    pub rgb: f32,
    /// On SoftRas' image.
    pub rgb_soft: f32,
    pub silhouette: f32,
    pub keypoints: f32,
    pub normal_consistency: f32,
    pub face_area: f32,
    pub laplacian: f32,
    /// On accelerations, a frame.
    pub motion: f32,
    /// On the joints' way from where the stage found them, a frame.
    pub anchor: f32,
}

impl Weights {
    /// Whether any image of the colours is compared.
    pub fn compare_colours(&self) -> bool {
        self.rgb != 0.0 || self.rgb_soft != 0.0
    }
}

/// Learning rates (Adam), at the start of a stage.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Rates {
    pub betas: f32,
    /// Radians.
    pub pose: f32,
    /// Metres.
    pub transl: f32,
    /// Metres, see [`DIRECT_OFFSET_RATE`].
    pub offsets: f32,
    pub face_colours: f32,
    pub texcoords: f32,
    pub field: f32,
}

/// What makes the moves of D smooth.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Preconditioner {
    /// The gradient as it is.
    None,
    /// Pairs of diffusion steps on the gradient ([`crate::ops::diffuse`]).
    Diffusion { pairs: usize },
    /// Steps in coordinates of `(I + λL)` ([`crate::ops::large_steps`]).
    LargeSteps { lambda: f32 },
}

/// Which frames an epoch looks at.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FrameSampling {
    /// Each once.
    Uniform,
    /// As many as there are, those with large colour losses more often (between half and twice as often as the mean).
    ByError,
}

/// One stretch of a stage at one resolution.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Phase {
    /// Passes over all frames, where they are enough for [`FitConfig::min_steps_a_pass`].
    pub epochs: u32,
    /// 0 = full resolution, 1 = half.
    pub level: usize,
    /// SoftRas face blur, squared units of half the image side.
    pub sigma: f32,
    /// SoftRas depth softness γ·(far − near), metres.
    pub depth_softness_m: f32,
    /// SoftRas' reach: faces further outside than `d² = cut·σ` do not count.
    pub cut: f32,
    /// Factor on all learning rates.
    pub rate: f32,
    /// Whether D is fitted in this phase (else only β, pose and placement).
    pub offsets: bool,
    pub preconditioner: Preconditioner,
    /// Factor on the rates of pose and placement.
    pub pose_rate: f32,
}

/// One stage: what it weighs, what it moves, and for how long.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct StageConfig {
    pub weights: Weights,
    /// Whether β and D are fitted; else they stand, and the terms that look at the mesh alone do not count.
    pub shape: bool,
    /// What is left of all learning rates at the end of the stage: they fall steadily, by the same factor in each step.
    pub rate_end: f32,
    pub phases: Vec<Phase>,
}

/// Everything that a fit depends on besides the clip and the body.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct FitConfig {
    pub seed: u64,
    /// Frames a step.
    pub batch: usize,
    /// What a pass over the clip has at least; a clip of fewer frames is passed over more often. A texture needs its steps
    /// however few its frames are.
    pub min_steps_a_pass: u32,
    pub frame_sampling: FrameSampling,
    pub silhouette_gradient: SilhouetteGradient,
    /// Whether each phase of stage 1 starts from the face colours that are best for its geometry, solved in closed form.
    pub solve_face_colours: bool,
    /// The part of a turn over which steps of pose and placement are spread; 0: each frame steps for itself.
    pub pose_smoothing: f32,
    /// How far given poses may go from where a stage began: as far as they are off. Others go as is usual of each joint.
    #[serde(default)]
    pub held: Option<Trust>,
    /// Whether the keypoints of the hips count besides those of limbs and nose, as stage 0 has understood them.
    pub hip_keypoints: bool,
    /// Whether the light is told from the albedo ([`crate::ops::light`]); else the colours hold both.
    pub light: bool,
    /// Whether the light stands as the fit's start has it; else each phase solves it anew.
    pub light_stands: bool,
    /// Whether exposure and white balance that the camera has changed are taken out of the pictures ([`super::gains`]).
    pub gains: bool,
    /// Whether the texture is told the colours of what no frame shows, by its surroundings and the body's other half.
    pub fill_unseen: bool,
    /// Whether poses and surface are adjusted to all frames at once in the end ([`super::bundle`]).
    pub bundle: bool,
    /// Whether cloth from leg to leg is looked for in the end, filled and carried by both legs ([`super::skirt`]).
    pub skirts: bool,
    /// Whether the body loses toes and ears that shoes and hair cover ([`super::covered`]).
    pub covered: bool,
    /// Whether the texture goes on with larger pictures and close-ups of the head in the end ([`super::detail`]).
    pub detail: bool,
    pub rates: Rates,
    /// Stage 1, with one colour a face.
    pub geometry: StageConfig,
    /// Stage 2, with the texture. In `standard` the shape goes on moving: a texture has edges that one colour a face has not.
    pub texture: StageConfig,
    /// Part of the covered pixels that a texture step looks at.
    pub pixel_rate: f32,
    /// But of one frame at most so many.
    pub most_pixels: Option<usize>,
    /// Whether a pixel counts less for the texture the more slantingly the surface lies in it.
    pub facing: bool,
    pub field: TextureFieldConfig,
}

impl FitConfig {
    /// Passes of a phase over a clip of `n_frames`, and the steps of each.
    pub fn passes(&self, phase: &Phase, n_frames: usize) -> (u32, u32) {
        let steps = n_frames.div_ceil(self.batch).max(1) as u32;
        (phase.epochs * self.min_steps_a_pass.div_ceil(steps).max(1), steps)
    }

    /// Steps of `phases` over a clip of `n_frames`.
    pub fn steps(&self, phases: &[Phase], n_frames: usize) -> u32 {
        phases.iter().map(|phase| self.passes(phase, n_frames)).map(|(passes, steps)| passes * steps).sum()
    }

    /// From where on a channel of a picture counts as white, which a light may exceed.
    pub fn white(&self) -> u8 {
        if self.light { 250 } else { u8::MAX }
    }

    /// The phases of all stages.
    pub fn phases(&self) -> impl Iterator<Item = &Phase> {
        self.geometry.phases.iter().chain(&self.texture.phases)
    }

    /// A first look: geometry at half resolution, few passes.
    pub fn draft(seed: u64) -> Self {
        let mut config = Self::standard(seed);
        config.geometry.phases = vec![Phase { epochs: 20, ..COARSE }];
        config.texture.phases = vec![Phase { epochs: 24, ..TEXTURED }];
        // After so few passes shape and poses are still on their way (docs/lab/fit.md, "How far learning rates fall").
        config.texture.rate_end = 0.3;
        config.bundle = false;
        config
    }

    /// Good quality in minutes on two cores.
    pub fn standard(seed: u64) -> Self {
        // D from the start: a naked body can only follow clothes by a wrong β and wrong poses.
        let geometry = vec![
            Phase { epochs: 42, ..COARSE },
            Phase { epochs: 30, preconditioner: Preconditioner::LargeSteps { lambda: 4.0 }, rate: 0.7, ..FINE },
        ];
        // Shape and pictures gain by each pass (docs/lab/fit.md, "Passes with the texture").
        let texture = vec![Phase { epochs: 40, ..TEXTURED }];
        Self {
            seed,
            batch: 4,
            min_steps_a_pass: 6,
            frame_sampling: FrameSampling::ByError,
            silhouette_gradient: SilhouetteGradient::Edge,
            solve_face_colours: true,
            pose_smoothing: 1.0 / 30.0,
            held: None,
            hip_keypoints: true,
            light: true,
            light_stands: false,
            gains: true,
            fill_unseen: true,
            bundle: true,
            skirts: true,
            covered: true,
            detail: true,
            rates: Rates {
                betas: 1e-2,
                pose: 4e-3,
                transl: 3e-3,
                offsets: 1e-2,
                face_colours: 1e-2,
                texcoords: 2e-4,
                field: 1e-2,
            },
            geometry: StageConfig { weights: GEOMETRY, shape: true, rate_end: RATE_END, phases: geometry },
            // By then pictures know better where limbs are than a detector does (docs/lab/fit.md, "Keypoints in stage 2").
            texture: StageConfig {
                weights: Weights { rgb_soft: 0.0, keypoints: 0.25 * GEOMETRY.keypoints, ..GEOMETRY },
                shape: true,
                rate_end: RATE_END,
                phases: texture,
            },
            pixel_rate: 0.5,
            most_pixels: None,
            facing: false,
            field: TextureFieldConfig::default(),
        }
    }

    /// As [`FitConfig::standard`], but with a geometry that has seen no colours (after Alldieck et al. 2018, VideoAvatar):
    /// silhouettes, keypoints and the regularisers alone; the texture is fitted afterwards, and poses stand meanwhile.
    pub fn silhouette_only(seed: u64) -> Self {
        let mut config = Self::standard(seed).with_shape_standing();
        for weights in [&mut config.geometry.weights, &mut config.texture.weights] {
            (weights.rgb, weights.rgb_soft) = (0.0, 0.0);
        }
        config.texture.weights.rgb = 1.0;
        (config.bundle, config.covered) = (false, false);
        config.texture.phases.iter_mut().for_each(|phase| phase.pose_rate = 0.0);
        config
    }

    /// Stage 2 as the paper has it (§3.6): β and D stand, and poses are refined through the hard and the soft image.
    pub fn with_shape_standing(mut self) -> Self {
        (self.texture.shape, self.texture.rate_end) = (false, RATE_END);
        self.texture.weights = Weights {
            keypoints: 0.0,
            normal_consistency: 0.0,
            face_area: 0.0,
            laplacian: 0.0,
            rgb_soft: GEOMETRY.rgb_soft,
            ..self.texture.weights
        };
        self.texture.phases.iter_mut().for_each(|phase| phase.pose_rate = 0.3);
        self
    }

    /// Some more passes with the texture alone, in stage 2; shape and poses stand. For a surface that has changed since.
    pub fn texture_alone(mut self) -> Self {
        let Weights { rgb, rgb_soft, silhouette, .. } = self.texture.weights;
        (self.texture.shape, self.texture.rate_end) = (false, RATE_END);
        self.texture.weights = Weights { rgb, rgb_soft, silhouette, ..Weights::default() };
        let last = self.texture.phases.pop();
        self.texture.phases = last.map(|last| Phase { epochs: ALONE, pose_rate: 0.0, ..last }).into_iter().collect();
        self
    }

    /// Some last passes with the texture alone, on larger pictures ([`super::detail`]).
    pub fn detailed(self, passes: u32) -> Self {
        let mut config = self.texture_alone();
        config.texture.phases.iter_mut().for_each(|phase| phase.epochs = passes);
        Self { pixel_rate: 1.0, most_pixels: Some(MOST_PIXELS), facing: true, light_stands: true, ..config }
    }

    /// Everything at once, the paper's "moving targets" (§3.6): the losses of the geometry stage, and as many passes as
    /// both stages have; those of the texture stage go on like the last of the geometry stage.
    pub fn joint(mut self) -> Self {
        let mut phases = std::mem::take(&mut self.geometry.phases);
        let last = phases.last().cloned();
        let more = self.texture.phases.iter();
        phases.extend(more.map(|p| last.clone().map_or(p.clone(), |last| Phase { epochs: p.epochs, ..last })));
        self.texture = StageConfig { phases, ..self.geometry.clone() };
        // Borders need a whole image.
        self.pixel_rate = 1.0;
        self
    }

    /// The paper's method as far as it tells: NMR silhouettes, plain offsets, full resolution throughout.
    pub fn paper(seed: u64) -> Self {
        let mut config = Self::standard(seed).with_shape_standing();
        let plain = Phase { preconditioner: Preconditioner::None, cut: SoftRasterizeParams::CUT as f32, ..FINE };
        config.silhouette_gradient = SilhouetteGradient::Nmr;
        config.light = false;
        config.fill_unseen = false;
        (config.gains, config.bundle, config.skirts, config.covered, config.detail) =
            (false, false, false, false, false);
        config.min_steps_a_pass = 1;
        config.rates.offsets = DIRECT_OFFSET_RATE;
        config.frame_sampling = FrameSampling::Uniform;
        config.solve_face_colours = false;
        config.pose_smoothing = 0.0;
        config.hip_keypoints = false;
        config.geometry.weights.keypoints = 0.02;
        for weights in [&mut config.geometry.weights, &mut config.texture.weights] {
            (weights.motion, weights.anchor) = (0.0, 0.0);
        }
        config.geometry.phases =
            vec![Phase { epochs: 10, offsets: false, ..plain.clone() }, Phase { epochs: 40, ..plain.clone() }];
        config.texture.phases = vec![Phase { epochs: 40, pose_rate: 0.3, ..plain }];
        config.pixel_rate = 1.0;
        config
    }
}

/// Metres: the rate of D where its own steps are taken. With large steps it is that of u, whose steps move D by less, since
/// the solver spreads them.
pub const DIRECT_OFFSET_RATE: f32 = 1.5e-3;

/// Where a stage ends whose parameters have come to rest.
const RATE_END: f32 = 0.1;

const GEOMETRY: Weights = Weights {
    rgb: 1.0,
    rgb_soft: 1.0,
    silhouette: 2.0,
    keypoints: 0.05,
    normal_consistency: 0.2,
    face_area: 0.02,
    laplacian: 0.5,
    motion: 2e-3,
    anchor: 2e-3,
};

const COARSE: Phase = Phase {
    epochs: 0,
    level: 1,
    sigma: 1e-4,
    depth_softness_m: 0.02,
    // Colours as far out as the reference's 9.21 bring nothing (docs/lab/fit.md, "How far colours reach").
    cut: 4.0,
    rate: 1.0,
    offsets: true,
    preconditioner: Preconditioner::LargeSteps { lambda: 10.0 },
    pose_rate: 1.0,
};

const FINE: Phase = Phase { level: 0, sigma: 2e-5, depth_softness_m: 0.01, ..COARSE };

/// Passes of [`FitConfig::texture_alone`].
const ALONE: u32 = 6;

/// Pixels of a frame in a pass of [`FitConfig::detailed`].
const MOST_PIXELS: usize = 30_000;

const TEXTURED: Phase = Phase { preconditioner: Preconditioner::LargeSteps { lambda: 4.0 }, pose_rate: 0.5, ..FINE };

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_configuration_comes_back_from_json() {
        for config in
            [FitConfig::draft(1), FitConfig::standard(2).joint(), FitConfig::paper(3), FitConfig::silhouette_only(4)]
        {
            let json = serde_json::to_string(&config).unwrap();
            assert_eq!(serde_json::from_str::<FitConfig>(&json).unwrap(), config);
        }
    }

    #[test]
    fn short_clips_are_passed_over_more_often() {
        let config = FitConfig::standard(0);
        let phase = Phase { epochs: 10, ..FINE };
        let passes = [1, 8, 20, 24, 61].map(|n| config.passes(&phase, n));
        assert_eq!(passes, [(60, 1), (30, 2), (20, 5), (10, 6), (10, 16)]);
        assert_eq!(FitConfig::paper(0).passes(&phase, 8), (10, 2), "the paper's passes are its own");
        assert_eq!(config.steps(&config.geometry.phases, 61), (42 + 30) * 16);
    }

    #[test]
    fn the_joint_fit_has_the_passes_of_both_stages() {
        let passes = |config: &FitConfig| config.phases().map(|p| p.epochs).sum::<u32>();
        let (standard, joint) = (FitConfig::standard(0), FitConfig::standard(0).joint());
        assert_eq!(passes(&joint), passes(&standard));
        assert!(joint.geometry.phases.is_empty() && joint.texture.shape && joint.texture.phases.len() == 3);
        assert_eq!(joint.texture.weights, standard.geometry.weights);
    }
}
