//! What a picture shall show, and whether it can be made.

use super::RenderError;
use crate::avatar::AvatarModel;
use crate::avatar::pose::Pose;
use crate::avatar::trace::{MAX_SIDE_PX, Shading};
use crate::body::Body;
use crate::camera::Camera;
use crate::picture::{Background, Light};

/// Where the person stands, world space, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Place {
    /// SMPL's `transl`: the pelvis ends at `J0(β) + transl`.
    Transl([f32; 3]),
    /// The position of the pelvis joint.
    Pelvis([f32; 3]),
}

impl Place {
    /// The same place as SMPL's `transl`, for a body of these betas.
    pub fn transl(self, body: &Body, betas: &[f32]) -> [f32; 3] {
        match self {
            Place::Transl(transl) => transl,
            Place::Pelvis(pelvis) => {
                let at = body.shaped_joints(betas)[0];
                std::array::from_fn(|k| pelvis[k] - at[k])
            }
        }
    }
}

/// A picture to render.
#[derive(Clone, Debug, PartialEq)]
pub struct RenderSpec {
    pub pose: Pose,
    pub place: Place,
    /// The avatar's own where absent; missing ones count as zero.
    pub betas: Option<Vec<f32>>,
    /// Size, intrinsics, world to camera, lens.
    pub camera: Camera,
    pub background: Background,
    pub light: Light,
    /// Samples along a pixel's side, 1 to 8: coverage is their mean, and each surface counts by its samples.
    pub samples: u32,
    /// `None`: as the texture asks for at this distance.
    pub shading: Option<Shading>,
}

impl RenderSpec {
    /// Captured frame `k` (an index into `frames`) as the capture's camera saw it, 3×3 samples a pixel, transparent.
    ///
    /// # Panics
    /// When there is no such frame.
    pub fn of_frame(model: &AvatarModel, k: usize) -> Self {
        Self {
            pose: model.poses[k],
            place: Place::Transl(model.transl[k]),
            betas: None,
            camera: model.camera.clone(),
            background: Background::Transparent,
            light: Light::Captured,
            samples: 3,
            shading: None,
        }
    }

    /// [`RenderError::Invalid`] for a picture that cannot be.
    pub(in crate::avatar) fn check(&self, model: &AvatarModel) -> Result<(), RenderError> {
        let invalid = |what: String| Err(RenderError::Invalid(what));
        let camera = &self.camera;
        if !(1..=MAX_SIDE_PX).contains(&camera.width) || !(1..=MAX_SIDE_PX).contains(&camera.height) {
            let (w, h) = (camera.width, camera.height);
            return invalid(format!("camera: a picture of {w}×{h} px, expected 1 to {MAX_SIDE_PX} a side"));
        }
        let focal = |f: f64| f.is_finite() && f > 0.0;
        if !focal(camera.fx) || !focal(camera.fy) {
            return invalid(format!("camera: fx {} and fy {}, expected positive", camera.fx, camera.fy));
        }
        let numbers = [camera.cx, camera.cy];
        let numbers = numbers.iter().chain(&camera.distortion).chain(&camera.rotation).chain(&camera.translation);
        if numbers.into_iter().any(|x| !x.is_finite()) {
            return invalid("camera: a value is not finite".to_owned());
        }
        let (Place::Transl(place) | Place::Pelvis(place)) = self.place;
        if self.pose.iter().chain(&place).any(|x| !x.is_finite()) {
            return invalid("pose: a value is not finite".to_owned());
        }
        if let Some(betas) = &self.betas
            && (betas.len() > model.body.n_betas || betas.iter().any(|b| !b.is_finite()))
        {
            return invalid(format!("betas: {} values, expected at most {}, finite", betas.len(), model.body.n_betas));
        }
        if !(1..=8).contains(&self.samples) {
            return invalid(format!("samples: {}, expected 1 to 8", self.samples));
        }
        Ok(())
    }
}
