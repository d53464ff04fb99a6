//! What a client may ask of a render, and the checks before a worker sees it.

use serde::Deserialize;
use serde_json::Value;

use crate::camera::{self, Camera, is_rotation};
use crate::http::avatars::check_frame;
use crate::http::error::ApiError;
use crate::jobs::Avatar;
use crate::jobs::render::{ImageRequest, Place, PoseSource};
use crate::json;
use crate::picture::{Background, Light};

const POSE_VALUES: usize = 72;
/// No importer keeps more of a body.
const MAX_BETAS: usize = 16;
/// Of a picture.
const MAX_SIDE_PX: u32 = 4096;
/// Rotations further away than this from a full turn are a mistake of units.
const MAX_ANGLE: f64 = 100.0;
/// Metres and pixels beyond this are no picture of a person.
const MAX_COORDINATE: f64 = 1e6;

/// A picture of an avatar. Either `pose` or `frame`.
#[derive(Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({ "frame": 0, "background": "#ffffff" }))]
pub(in crate::http) struct RenderBody {
    /// 72 numbers: axis-angle of the 24 joints in SMPL's order; joint 0 is the global orientation.
    #[schema(min_items = 72, max_items = 72)]
    pub pose: Option<Vec<f64>>,
    /// A frame of the video, from 0: the pose and place that were fitted to it, or to the nearest that was fitted.
    pub frame: Option<u32>,
    /// With `pose`: SMPL's `transl`, metres, as `trans` of `motion.npz`.
    pub translation: Option<[f64; 3]>,
    /// With `pose`: where the pelvis is, metres; wins over `translation`. With neither, as in the first frame.
    pub pelvis: Option<[f64; 3]>,
    /// Another shape than the fitted one.
    #[schema(max_items = 16)]
    pub betas: Option<Vec<f64>>,
    /// Absent: the capture's.
    #[schema(value_type = Option<CameraBody>)]
    pub camera: Option<Value>,
    #[serde(default)]
    #[schema(inline)]
    pub light: Light,
    /// `transparent` or `#rrggbb`.
    #[serde(default = "transparent")]
    #[schema(default = "transparent", pattern = "^(transparent|#[0-9a-fA-F]{6})$")]
    pub background: String,
    #[serde(default)]
    #[schema(inline)]
    pub format: Format,
}

fn transparent() -> String {
    "transparent".into()
}

#[derive(Clone, Copy, Debug, Default, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "lowercase")]
pub(in crate::http) enum Format {
    #[default]
    Png,
}

/// A pinhole camera in OpenCV's axes: x right, y down, z forward; pixel centres at half integers.
/// As in a clip's camera.json, other fields may stand beside these.
#[derive(utoipa::ToSchema)]
#[expect(dead_code, reason = "describes the object for the API's document; `camera::from_json` reads it")]
pub(in crate::http) struct CameraBody {
    /// Pixels of the picture.
    #[schema(minimum = 1, maximum = 4096)]
    width: u64,
    #[schema(minimum = 1, maximum = 4096)]
    height: u64,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    /// 3×3, as three rows or as nine numbers row by row: `x_cam = R·x_world + t`.
    rotation: Option<Vec<f64>>,
    translation: Option<[f64; 3]>,
    /// OpenCV's `[k1, k2, p1, p2, k3]`, shorter if the rest is zero, or the same by name.
    distortion: Option<Vec<f64>>,
    /// The coefficients may also stand beside the other fields; zero where absent.
    #[schema(default = 0.0, required = false)]
    k1: f64,
    #[schema(default = 0.0, required = false)]
    k2: f64,
    #[schema(default = 0.0, required = false)]
    p1: f64,
    #[schema(default = 0.0, required = false)]
    p2: f64,
    #[schema(default = 0.0, required = false)]
    k3: f64,
}

fn wrong(part: &str, detail: impl Into<String>, expected: impl Into<String>) -> ApiError {
    ApiError::Input { detail: detail.into(), part: part.into(), frame: None, expected: expected.into() }
}

fn check_numbers(part: &str, values: &[f64], most: f64) -> Result<(), ApiError> {
    match values.iter().position(|v| !v.is_finite() || v.abs() > most) {
        None => Ok(()),
        Some(i) => Err(wrong(part, format!("{part}[{i}] is {}", values[i]), format!("finite numbers up to {most}"))),
    }
}

impl RenderBody {
    pub fn check(self, avatar: &Avatar) -> Result<ImageRequest, ApiError> {
        let pose = self.pose_source(avatar)?;
        if let Some(betas) = &self.betas {
            if betas.len() > MAX_BETAS {
                let expected = format!("at most {MAX_BETAS} numbers");
                return Err(wrong("betas", format!("there are {} betas", betas.len()), expected));
            }
            check_numbers("betas", betas, 100.0)?;
        }
        let Format::Png = self.format;
        Ok(ImageRequest {
            pose,
            betas: self.betas.map(|betas| betas.iter().map(|&b| b as f32).collect()),
            camera: self.camera.map_or_else(|| Ok(avatar.camera.clone()), camera)?,
            light: self.light,
            background: background(&self.background)?,
        })
    }

    fn pose_source(&self, avatar: &Avatar) -> Result<PoseSource, ApiError> {
        let given = match (&self.pose, self.frame) {
            (Some(pose), None) => pose,
            (None, Some(frame)) => {
                if self.translation.is_some() || self.pelvis.is_some() {
                    return Err(wrong("frame", "a frame brings its own place", "translation or pelvis only with pose"));
                }
                check_frame(avatar, frame)?;
                return Ok(PoseSource::Frame(frame));
            }
            _ => return Err(wrong("pose", "a render needs a pose or a frame", "either pose or frame")),
        };
        if given.len() != POSE_VALUES {
            let expected = format!("{POSE_VALUES} numbers: axis-angle of 24 joints");
            return Err(wrong("pose", format!("the pose has {} numbers", given.len()), expected));
        }
        check_numbers("pose", given, MAX_ANGLE)?;
        let point = |part: &str, p: [f64; 3]| check_numbers(part, &p, MAX_COORDINATE).map(|()| p.map(|v| v as f32));
        let place = match (self.pelvis, self.translation) {
            (Some(p), _) => Some(Place::Pelvis(point("pelvis", p)?)),
            (None, Some(t)) => Some(Place::Translation(point("translation", t)?)),
            (None, None) => None,
        };
        Ok(PoseSource::Given { pose: given.iter().map(|&v| v as f32).collect(), place })
    }
}

fn background(text: &str) -> Result<Background, ApiError> {
    text.parse().map_err(|_| wrong("background", format!("background is {text:?}"), Background::EXPECTED))
}

fn camera(json: Value) -> Result<Camera, ApiError> {
    let camera = json::fields(json).and_then(|json| camera::from_json(&json));
    let camera = camera.map_err(|error| ApiError::json(error, "camera"))?;
    for (name, side) in [("camera.width", camera.width), ("camera.height", camera.height)] {
        if !(1..=MAX_SIDE_PX).contains(&side) {
            return Err(wrong(name, format!("{name} is {side}"), format!("1 to {MAX_SIDE_PX}")));
        }
    }
    for (name, focal) in [("camera.fx", camera.fx), ("camera.fy", camera.fy)] {
        if !(focal > 0.0 && focal <= MAX_COORDINATE) {
            return Err(wrong(name, format!("{name} is {focal}"), "a focal length above 0, in pixels"));
        }
    }
    check_numbers("camera.cx", &[camera.cx], MAX_COORDINATE)?;
    check_numbers("camera.cy", &[camera.cy], MAX_COORDINATE)?;
    check_numbers("camera.translation", &camera.translation, MAX_COORDINATE)?;
    check_numbers("camera.distortion", &camera.distortion, 100.0)?;
    if !is_rotation(&camera.rotation) {
        return Err(wrong("camera.rotation", "the rows are not those of a rotation", "an orthonormal 3×3 matrix"));
    }
    Ok(camera)
}
