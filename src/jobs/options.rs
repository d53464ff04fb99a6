//! What a client may ask of a fit.

use serde::{Deserialize, Serialize};

use crate::data_dir::{BODY_NAME, is_body_name};
use crate::json::{self, JsonError};

/// How much work a fit does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// A first look: few frames, few iterations, a small picture.
    Draft,
    /// Good quality in minutes.
    #[default]
    Standard,
    /// The published method's sizes and iterations.
    Paper,
    /// For comparisons: as standard, but the geometry is fitted to silhouettes and keypoints alone.
    SilhouetteOnly,
}

/// Of a seed: 2⁵³ − 1, which every client's numbers hold.
const MOST_SEED: u64 = (1 << 53) - 1;

/// The `options` part of an upload. Every field may be left out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct JobOptions {
    /// How much work the fit does; the other options override what the preset sets.
    #[schema(default = "standard")]
    pub preset: Preset,
    /// At most this many frames are used, evenly spread over the clip. Absent: the preset's.
    #[schema(minimum = 2, maximum = 10000)]
    pub max_frames: Option<u32>,
    /// Images whose longer side has more pixels are scaled down to this. Absent: the preset's. But for `paper`, the texture's last
    /// passes see larger ones, in which the person has up to 1600 pixels.
    #[schema(minimum = 64, maximum = 4096)]
    pub max_side_px: Option<u32>,
    /// Name of the body model; the server's `bodies` folder holds them.
    #[schema(default = "default", pattern = "^[A-Za-z0-9_-]{1,64}$")]
    pub body: String,
    /// Seed of everything random in the fit. The same program, inputs, options and device give the same avatar, bit by bit.
    #[schema(default = 0, maximum = 9007199254740991_i64)]
    pub seed: u64,
    /// The person's height, metres. One camera cannot tell a small person near from a tall one far; absent, the mean
    /// height of adults, 1.65 m, decides.
    #[schema(minimum = 0.5, maximum = 2.5)]
    pub height_m: Option<f64>,
    /// Fit with the given focal length even where the clip contradicts it. Without this, one that is more than 13 % off what the clip
    /// tells is replaced by that; either way the report says so (`focal_contradicted`).
    #[schema(default = false)]
    pub trust_camera: bool,
    /// Side of the baked texture: 2048 or 4096.
    #[schema(default = 2048)]
    pub texture_px: u32,
    /// Jobs of a higher priority go first; among equals the older one.
    #[schema(default = 0, minimum = -100, maximum = 100)]
    pub priority: i32,
    /// The job fails if it has not ended so many seconds after it was accepted, or queued again by a retry.
    #[schema(minimum = 1, maximum = 2592000)]
    pub deadline_secs: Option<u64>,
}

impl Default for JobOptions {
    fn default() -> Self {
        JobOptions {
            preset: Preset::default(),
            max_frames: None,
            max_side_px: None,
            body: "default".into(),
            seed: 0,
            height_m: None,
            trust_camera: false,
            texture_px: 2048,
            priority: 0,
            deadline_secs: None,
        }
    }
}

impl JobOptions {
    /// Reads and checks the JSON of the `options` part.
    pub fn parse(json: &[u8]) -> Result<JobOptions, JsonError> {
        let options: JobOptions = json::object(json)?;
        options.check()?;
        Ok(options)
    }

    /// Ranges that the types do not hold.
    pub fn check(&self) -> Result<(), JsonError> {
        let wrong = |field: &str, got: String, expected: &str| JsonError {
            field: Some(field.into()),
            message: format!("{field} is {got}"),
            expected: Some(expected.into()),
        };
        if let Some(n) = self.max_frames.filter(|n| !(2..=10_000).contains(n)) {
            return Err(wrong("max_frames", n.to_string(), "2 to 10000"));
        }
        if let Some(n) = self.max_side_px.filter(|n| !(64..=4096).contains(n)) {
            return Err(wrong("max_side_px", n.to_string(), "64 to 4096"));
        }
        if let Some(h) = self.height_m.filter(|h| !(0.5..=2.5).contains(h)) {
            return Err(wrong("height_m", h.to_string(), "0.5 to 2.5"));
        }
        if self.seed > MOST_SEED {
            return Err(wrong("seed", self.seed.to_string(), &format!("0 to {MOST_SEED}")));
        }
        if ![2048, 4096].contains(&self.texture_px) {
            return Err(wrong("texture_px", self.texture_px.to_string(), "2048 or 4096"));
        }
        if !(-100..=100).contains(&self.priority) {
            return Err(wrong("priority", self.priority.to_string(), "-100 to 100"));
        }
        if let Some(secs) = self.deadline_secs.filter(|secs| !(1..=2_592_000).contains(secs)) {
            return Err(wrong("deadline_secs", secs.to_string(), "1 to 2592000"));
        }
        if !is_body_name(&self.body) {
            return Err(wrong("body", format!("{:?}", self.body), BODY_NAME));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_object_is_the_default() {
        assert_eq!(JobOptions::parse(b"{}").unwrap(), JobOptions::default());
    }

    #[test]
    fn every_field_is_read() {
        let json =
            br#"{"preset":"draft","max_frames":30,"max_side_px":360,"body":"smpl-neutral","seed":7,"texture_px":4096}"#;
        let options = JobOptions::parse(json).unwrap();
        assert_eq!((options.preset, options.max_frames, options.max_side_px), (Preset::Draft, Some(30), Some(360)));
        assert_eq!((options.body.as_str(), options.seed, options.texture_px), ("smpl-neutral", 7, 4096));
    }

    #[test]
    fn presets_have_names_with_hyphens() {
        let options = JobOptions::parse(br#"{"preset":"silhouette-only"}"#).unwrap();
        assert_eq!(options.preset, Preset::SilhouetteOnly);
    }

    #[test]
    fn each_mistake_names_its_field() {
        for (json, field) in [
            (r#"{"preset":"best"}"#, "preset"),
            (r#"{"speed":1}"#, "speed"),
            (r#"{"max_frames":1}"#, "max_frames"),
            (r#"{"seed":9007199254740992}"#, "seed"),
            (r#"{"max_frames":"many"}"#, "max_frames"),
            (r#"{"max_side_px":100000}"#, "max_side_px"),
            (r#"{"height_m":17.5}"#, "height_m"),
            (r#"{"texture_px":1000}"#, "texture_px"),
            (r#"{"priority":101}"#, "priority"),
            (r#"{"priority":99999999999}"#, "priority"),
            (r#"{"deadline_secs":0}"#, "deadline_secs"),
            (r#"{"body":"../etc"}"#, "body"),
            (r#"{"seed":-1}"#, "seed"),
        ] {
            let error = JobOptions::parse(json.as_bytes()).unwrap_err();
            assert_eq!(error.field.as_deref(), Some(field), "{json}: {error:?}");
            assert!(error.expected.is_some(), "{json}: {error:?}");
        }
    }

    #[test]
    fn what_is_no_object_is_refused() {
        let by_place = r#"["draft",2,64,"default",5,1.8,true,2048,0,null]"#;
        for json in ["", "[1]", by_place, "null", "{} {}", "{\"preset\":"] {
            assert!(JobOptions::parse(json.as_bytes()).is_err(), "{json}");
        }
    }
}
