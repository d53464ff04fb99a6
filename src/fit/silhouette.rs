//! The silhouette term of a frame: IoU of the hard coverage (paper §3.5), whose gradient reaches the mesh through the
//! borders of what is drawn. The soft coverage would not do here: where a body's triangles are as small as the blur, their
//! many shares add up outside the outline, and the fit shrinks by about a pixel all round.

use super::config::SilhouetteGradient;
use super::frame_step::FrameStep;
use super::losses::{Losses, Term};
use super::scene::Scene;
use crate::gpu::{Buffer, Recorder};
use crate::ops::edge_gradient::{EdgeGradient, RgbGradient};
use crate::ops::nmr::{Nmr, NmrConfig};
use crate::ops::silhouette_iou::SilhouetteIou;

/// Metres between a surface and what it hides, for a border to count.
const MIN_STEP: f64 = 0.02;

enum Border {
    Nmr(Nmr),
    Edge(EdgeGradient),
}

/// The loss and the way from its pixels to the mesh.
pub struct SilhouetteTerm {
    iou: SilhouetteIou,
    border: Border,
    grad_alpha: Buffer<f32>,
}

impl SilhouetteTerm {
    pub fn new(scene: &Scene, gradient: SilhouetteGradient) -> Self {
        let (gpu, n) = (&scene.gpu, scene.max_pixels);
        Self {
            iou: SilhouetteIou::new(gpu),
            border: match gradient {
                SilhouetteGradient::Nmr => Border::Nmr(Nmr::new(gpu, n, NmrConfig::default())),
                SilhouetteGradient::Edge => Border::Edge(EdgeGradient::new(gpu, n, MIN_STEP)),
            },
            grad_alpha: gpu.zeros("fit/grad_alpha", n),
        }
    }

    /// Records the loss of the scene's last hard image and adds its gradient to `grad_view`. With `rgb`, a colour image
    /// and its gradient, edge gradients move the borders between parts of the body by the colours too.
    pub(super) fn record(
        &self,
        recorder: &mut Recorder<'_>,
        scene: &Scene,
        frame: &FrameStep<'_>,
        rgb: Option<RgbGradient<'_>>,
        losses: &Losses,
    ) {
        let (level, n) = (frame.level, frame.level.camera.n_pixels());
        let weight = frame.part * frame.weights.silhouette;
        let rgb = rgb.filter(|_| matches!(self.border, Border::Edge(_)));
        if weight == 0.0 && rgb.is_none() {
            return;
        }
        recorder.clear(&self.grad_alpha);
        if weight != 0.0 {
            self.iou.forward(recorder, n, &scene.hard.alpha, frame.target(), losses.slot(Term::Silhouette));
            self.iou.backward(recorder, n, frame.target(), weight, &self.grad_alpha);
        }
        let (hard, view, grad_view) = (&scene.hard, &scene.view, &scene.grad_view);
        match &self.border {
            Border::Nmr(nmr) => nmr.backward(recorder, hard, &level.camera, view, None, &self.grad_alpha, grad_view),
            Border::Edge(edge) => edge.backward(recorder, hard, &level.camera, view, rgb, &self.grad_alpha, grad_view),
        }
    }
}
