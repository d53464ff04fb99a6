//! The image losses of one view, and which operators carry their gradients to the mesh: the part of a fit that studies
//! vary.

use std::sync::Arc;

use crate::camera::Camera;
use crate::gpu::{Buffer, Gpu, GpuError, Recorder};
use crate::mask::is_foreground;
use crate::ops::edge_gradient::{EdgeGradient, RgbGradient};
use crate::ops::hard_rasterize::{HardRasterizeConfig, HardRasterizer};
use crate::ops::nmr::{Nmr, NmrConfig};
use crate::ops::rgb_l1::{Pixels, RgbL1};
use crate::ops::silhouette_iou::SilhouetteIou;
use crate::ops::soft_rasterize::{SoftRasterizeParams, SoftRasterizer};
use crate::ops::{Corners, LossSlot, PixelList, Target, pack_pixel};

/// What carries the gradient of the hard image to the mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Border {
    /// NMR's scanline sweeps.
    Nmr,
    /// The derivative of what crosses the pixels' borders.
    Edge,
}

/// A soft colour image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Soft {
    /// Face blur, squared units of half the image side.
    pub sigma: f64,
    /// γ·(far − near), metres.
    pub depth_softness_m: f64,
}

/// Which losses there are besides the silhouette's, and how gradients reach the mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Objective {
    pub border: Border,
    /// The hard colour image counts too, through the same borders.
    pub hard_rgb: bool,
    /// The soft colour image counts too.
    pub soft_rgb: Option<Soft>,
    /// Metres between a surface and what it hides, for a border to count.
    pub min_step: f64,
    /// Weights of the colour losses, a foreground pixel, and of the silhouette's.
    pub rgb_weight: f32,
    pub silhouette_weight: f32,
}

/// A view of the truth on the device.
pub struct View {
    pub camera: Camera,
    target: Buffer<u32>,
    /// Pixels inside the mask
    inside: PixelList,
}

impl View {
    /// `pixels`: colours with coverage, `[height, width]`.
    pub fn new(gpu: &Gpu, camera: Camera, pixels: &[[u8; 4]]) -> Self {
        assert_eq!(pixels.len(), camera.n_pixels(), "pixels of a view");
        let packed: Vec<u32> = pixels.iter().map(|&[r, g, b, a]| pack_pixel([r, g, b], a)).collect();
        Self {
            target: gpu.upload("study/target", &packed),
            inside: PixelList::new(gpu, "study/inside", pixels.iter().map(|p| is_foreground(p[3]))),
            camera,
        }
    }
}

/// Metres of camera-space z that enclose what is drawn.
pub type DepthRange = (f64, f64);

const BACKGROUND: [f32; 3] = [0.0; 3];

/// The slots of [`ImageTerms::losses`].
pub const SILHOUETTE: usize = 0;
pub const RGB: usize = 1;
pub const RGB_SOFT: usize = 2;

enum BorderOp {
    Nmr(Nmr),
    Edge(EdgeGradient),
}

/// The operators of an objective with their scratch, for one mesh and views of up to `max_pixels`.
pub struct ImageTerms {
    objective: Objective,
    hard: HardRasterizer,
    border: BorderOp,
    soft: Option<(Soft, SoftRasterizer)>,
    rgb: RgbL1,
    iou: SilhouetteIou,
    image: Buffer<f32>,
    grad_image: Buffer<f32>,
    grad_alpha: Buffer<f32>,
    grad_soft: Buffer<f32>,
    /// Stays zero: the soft coverage is no part of any objective.
    /// What the operators find for colours, which are known here.
    grad_face_colours: Buffer<f32>,
    /// Sums over the recorded views, unweighted; see the constants above.
    losses: Buffer<f32>,
}

impl ImageTerms {
    pub fn new(gpu: &Gpu, corners: &Arc<Corners>, views: &[View], objective: Objective) -> Self {
        let n = views.iter().map(|v| v.camera.n_pixels()).max().unwrap_or(1);
        let soft = objective.soft_rgb.map(|soft| {
            let entries = SoftRasterizer::list_capacity(corners.n_faces(), n);
            (soft, SoftRasterizer::new(gpu, corners, n, entries))
        });
        Self {
            hard: HardRasterizer::new(gpu, corners, n, HardRasterizeConfig::default()),
            border: match objective.border {
                Border::Nmr => {
                    let config = NmrConfig { min_step: objective.min_step, ..NmrConfig::default() };
                    BorderOp::Nmr(Nmr::new(gpu, n, config))
                }
                Border::Edge => BorderOp::Edge(EdgeGradient::new(gpu, n, objective.min_step)),
            },
            soft,
            rgb: RgbL1::new(gpu, n),
            iou: SilhouetteIou::new(gpu),
            image: gpu.zeros("study/image", n * 3),
            grad_image: gpu.zeros("study/grad_image", RgbL1::room(n)),
            grad_alpha: gpu.zeros("study/grad_alpha", n),
            grad_soft: gpu.zeros("study/grad_soft", n * 3),
            grad_face_colours: gpu.zeros("study/grad_face_colours", corners.n_faces() * 3),
            losses: gpu.zeros("study/losses", 3),
            objective,
        }
    }

    /// Records the losses of a view for the mesh `points` in its camera's space, and adds `part` of their gradients to
    /// `grad_points`.
    #[expect(clippy::too_many_arguments, reason = "the operands of the losses")]
    pub fn record(
        &self,
        recorder: &mut Recorder<'_>,
        view: &View,
        points: &Buffer<f32>,
        depth: DepthRange,
        face_colours: &Buffer<f32>,
        part: f32,
        grad_points: &Buffer<f32>,
    ) {
        let (camera, n) = (&view.camera, view.camera.n_pixels());
        let target = Target::Packed { pixels: &view.target, offset: 0, background: Some(BACKGROUND) };
        let rgb_weight = part * self.objective.rgb_weight / view.inside.len().max(1) as f32;
        let slot = |index| LossSlot::new(&self.losses, index);

        self.hard.forward(recorder, camera, points);
        self.iou.forward(recorder, n, &self.hard.alpha, target, slot(SILHOUETTE));
        recorder.clear(&self.grad_alpha);
        self.iou.backward(recorder, n, target, part * self.objective.silhouette_weight, &self.grad_alpha);
        self.hard.shade(recorder, camera, face_colours, BACKGROUND, &self.image);
        self.rgb.forward_backward(
            recorder,
            n,
            &self.image,
            target,
            Pixels::All,
            slot(RGB),
            rgb_weight,
            &self.grad_image,
        );
        let rgb = RgbGradient { image: &self.image, grad_image: &self.grad_image };
        let rgb = self.objective.hard_rgb.then_some(rgb);
        let (hard, grad_alpha) = (&self.hard, &self.grad_alpha);
        match &self.border {
            BorderOp::Nmr(nmr) => nmr.backward(recorder, hard, camera, points, rgb, grad_alpha, grad_points),
            BorderOp::Edge(edge) => edge.backward(recorder, hard, camera, points, rgb, grad_alpha, grad_points),
        }

        let Some((soft, rasterizer)) = &self.soft else { return };
        let params = SoftRasterizeParams {
            sigma: soft.sigma,
            gamma: soft.depth_softness_m / (depth.1 - depth.0),
            near: depth.0,
            far: depth.1,
            background: BACKGROUND.map(f64::from),
            ..SoftRasterizeParams::new(camera.width, camera.height)
        };
        // Outside the mask the blur of near faces would only pull the mesh inwards, against the silhouette.
        let inside = Pixels::Listed(&view.inside);
        rasterizer.forward(recorder, &params, camera, points, face_colours, Some(&self.hard.zbuf));
        let Self { grad_soft, grad_face_colours, .. } = self;
        self.rgb.forward_backward(recorder, n, &rasterizer.rgb, target, inside, slot(RGB_SOFT), rgb_weight, grad_soft);
        rasterizer.backward(recorder, &params, camera, face_colours, grad_soft, None, grad_points, grad_face_colours);
    }

    /// The losses since the last call: silhouette, hard colours, soft colours. Waits.
    pub fn take_losses(&self, gpu: &Gpu) -> Result<Vec<f32>, GpuError> {
        let values = gpu.read(&self.losses)?;
        gpu.write(&self.losses, 0, &[0.0; 3]);
        Ok(values)
    }
}
