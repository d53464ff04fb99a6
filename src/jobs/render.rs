//! Renders of an avatar: what is asked and answered, and the trait behind which the device's thread lies.
//!
//! A handler never meets the device: it gives a [`RenderRequest`] to a [`Renderer`] and gets the path of a file.

use std::path::PathBuf;

use futures_util::future::BoxFuture;
use serde::{Deserialize, Serialize};
use tempfile::TempPath;

use crate::camera::Camera;
use crate::picture::{Background, Light};

/// A picture or a mesh to be made from an avatar model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RenderRequest {
    /// The avatar's `model.npz`.
    pub model: PathBuf,
    pub what: What,
}

/// What is to be made of the avatar.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum What {
    Image(Box<ImageRequest>),
    /// The mesh as posed in a frame of the video (or the nearest that was fitted), as PLY.
    Mesh {
        frame: u32,
    },
}

/// A picture of the avatar; its size is the camera's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ImageRequest {
    pub pose: PoseSource,
    /// Instead of the fitted shape.
    pub betas: Option<Vec<f32>>,
    pub camera: Camera,
    pub light: Light,
    pub background: Background,
}

/// Where a picture's pose comes from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PoseSource {
    /// The fitted pose and place in a frame of the video, from 0, or in the nearest that was fitted.
    Frame(u32),
    /// `pose`: 72 numbers. Without a place: the first fitted frame's pelvis.
    Given { pose: Vec<f32>, place: Option<Place> },
}

/// Where the body stands, in world space, metres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Place {
    /// SMPL's `transl`, added after skinning.
    Translation([f32; 3]),
    /// The position of the pelvis joint.
    Pelvis([f32; 3]),
}

/// Why there is no picture.
#[derive(Clone, Debug, PartialEq, thiserror::Error, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RenderError {
    /// Too many wait already.
    #[error("too many renders are waiting")]
    Busy,
    /// No worker answered in time, or there is none.
    #[error("no worker could render: {0}")]
    Unavailable(String),
    /// What was asked cannot be drawn.
    #[error("{0}")]
    Refused(String),
    /// The worker could not do it.
    #[error("rendering failed: {0}")]
    Failed(String),
}

/// Makes renders, somewhere else.
pub trait Renderer: Send + Sync + 'static {
    /// The file of the answer (PNG or PLY), which goes with whoever waits for it.
    fn render(&self, request: RenderRequest) -> BoxFuture<'_, Result<TempPath, RenderError>>;

    /// None when renders can be had; else why not.
    fn trouble(&self) -> Option<String>;
}

/// For a server without a worker.
pub struct NoRenderer;

impl Renderer for NoRenderer {
    fn render(&self, _request: RenderRequest) -> BoxFuture<'_, Result<TempPath, RenderError>> {
        Box::pin(async { Err(RenderError::Unavailable("this server runs without a worker".into())) })
    }

    fn trouble(&self) -> Option<String> {
        None
    }
}
