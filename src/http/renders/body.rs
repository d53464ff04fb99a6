//! What a client may ask of a render, and the checks before a worker sees it.

use serde::Deserialize;
use serde_json::Value;

use crate::camera::{Camera, is_rotation};
use crate::capture::{OddName, odd_name};
use crate::http::avatars::check_frame;
use crate::http::error::ApiError;
use crate::jobs::Avatar;
use crate::jobs::render::{Background, ImageRequest, Light, Place, PoseSource, hex_colour};
use crate::json::{self, JsonError};

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
#[derive(Deserialize, utoipa::ToSchema)]
pub(in crate::http) struct CameraBody {
    /// Pixels of the picture.
    #[schema(minimum = 1, maximum = 4096)]
    pub width: u64,
    #[schema(minimum = 1, maximum = 4096)]
    pub height: u64,
    pub fx: f64,
    pub fy: f64,
    pub cx: f64,
    pub cy: f64,
    /// 3×3, as three rows or as nine numbers row by row: `x_cam = R·x_world + t`.
    #[schema(value_type = Option<Vec<f64>>)]
    pub rotation: Option<Rotation>,
    pub translation: Option<[f64; 3]>,
    /// OpenCV's `[k1, k2, p1, p2, k3]`, shorter if the rest is zero, or the same by name.
    #[schema(value_type = Option<Vec<f64>>)]
    pub distortion: Option<Distortion>,
    /// The coefficients may also stand beside the other fields; zero where absent.
    #[serde(default)]
    pub k1: f64,
    #[serde(default)]
    pub k2: f64,
    #[serde(default)]
    pub p1: f64,
    #[serde(default)]
    pub p2: f64,
    #[serde(default)]
    pub k3: f64,
}

#[derive(Clone, Deserialize)]
#[serde(untagged, expecting = "expected at most five numbers, or k1, k2, p1, p2 and k3 by name")]
pub(in crate::http) enum Distortion {
    List(Vec<f64>),
    Named(Coefficients),
}

/// Of the lens, zero where absent.
#[derive(Clone, Copy, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(in crate::http) struct Coefficients {
    pub k1: f64,
    pub k2: f64,
    pub p1: f64,
    pub p2: f64,
    pub k3: f64,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(untagged, expecting = "expected nine numbers, or three rows of three")]
pub(in crate::http) enum Rotation {
    Rows([[f64; 3]; 3]),
    Flat([f64; 9]),
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
    if text == "transparent" {
        return Ok(Background::Transparent);
    }
    let colour = hex_colour(text)
        .ok_or_else(|| wrong("background", format!("background is {text:?}"), "transparent or #rrggbb"))?;
    Ok(Background::Colour(colour))
}

fn camera(json: Value) -> Result<Camera, ApiError> {
    let wrong = |error| ApiError::json(error, "camera");
    if let Some(OddName { name, message, expected }) = json.as_object().and_then(odd_name) {
        return Err(wrong(JsonError { field: Some(name), message, expected: Some(expected) }));
    }
    json::of_value::<CameraBody>(json).map_err(wrong)?.check()
}

impl CameraBody {
    fn check(self) -> Result<Camera, ApiError> {
        for (name, side) in [("camera.width", self.width), ("camera.height", self.height)] {
            if !(1..=u64::from(MAX_SIDE_PX)).contains(&side) {
                return Err(wrong(name, format!("{name} is {side}"), format!("1 to {MAX_SIDE_PX}")));
            }
        }
        for (name, focal) in [("camera.fx", self.fx), ("camera.fy", self.fy)] {
            if !(focal.is_finite() && focal > 0.0 && focal <= MAX_COORDINATE) {
                return Err(wrong(name, format!("{name} is {focal}"), "a focal length above 0, in pixels"));
            }
        }
        check_numbers("camera.cx", &[self.cx], MAX_COORDINATE)?;
        check_numbers("camera.cy", &[self.cy], MAX_COORDINATE)?;
        let translation = self.translation.unwrap_or_default();
        check_numbers("camera.translation", &translation, MAX_COORDINATE)?;
        let rotation = match self.rotation {
            None => [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            Some(Rotation::Flat(flat)) => flat,
            Some(Rotation::Rows(rows)) => std::array::from_fn(|i| rows[i / 3][i % 3]),
        };
        if !is_rotation(&rotation) {
            return Err(wrong("camera.rotation", "the rows are not those of a rotation", "an orthonormal 3×3 matrix"));
        }
        let distortion = self.lens()?;
        Ok(Camera {
            width: self.width as u32,
            height: self.height as u32,
            fx: self.fx,
            fy: self.fy,
            cx: self.cx,
            cy: self.cy,
            distortion,
            rotation,
            translation,
        })
    }
}

impl CameraBody {
    fn lens(&self) -> Result<[f64; 5], ApiError> {
        let lens = match &self.distortion {
            None => [self.k1, self.k2, self.p1, self.p2, self.k3],
            Some(Distortion::Named(named)) => [named.k1, named.k2, named.p1, named.p2, named.k3],
            Some(Distortion::List(list)) => {
                let mut lens = [0.0; 5];
                let Some(start) = lens.get_mut(..list.len()) else {
                    let detail = format!("the distortion has {} numbers", list.len());
                    return Err(wrong("camera.distortion", detail, "at most 5 numbers: k1, k2, p1, p2, k3"));
                };
                start.copy_from_slice(list);
                lens
            }
        };
        check_numbers("camera.distortion", &lens, 100.0)?;
        Ok(lens)
    }
}
