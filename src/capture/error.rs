//! What can be wrong with a clip, told so that its sender can mend it.

use std::fmt;

/// The part of an upload that an error is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Part {
    Video,
    Masks,
    Keypoints,
    Camera,
    Poses,
}

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Part::Video => "video",
            Part::Masks => "masks",
            Part::Keypoints => "keypoints",
            Part::Camera => "camera",
            Part::Poses => "poses",
        })
    }
}

/// Input that cannot be used. It displays as `masks, frame 12: the mask is empty (expected …)`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BadInput {
    pub part: Part,
    /// 0-based, in the uploaded video.
    pub frame: Option<u32>,
    pub message: String,
    pub expected: String,
}

impl BadInput {
    pub(super) fn new(part: Part, message: impl Into<String>, expected: impl Into<String>) -> Self {
        Self { part, frame: None, message: message.into(), expected: expected.into() }
    }

    pub(super) fn at(mut self, frame: usize) -> Self {
        self.frame = Some(frame as u32);
        self
    }
}

impl fmt::Display for BadInput {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.part)?;
        if let Some(frame) = self.frame {
            write!(f, ", frame {frame}")?;
        }
        write!(f, ": {} (expected {})", self.message, self.expected)
    }
}

impl std::error::Error for BadInput {}

/// Why a clip was not read.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// The sender's to mend.
    #[error(transparent)]
    Bad(#[from] BadInput),
    /// Ours: a missing tool, a full disk.
    #[error("{what}: {source}")]
    Internal { what: String, source: std::io::Error },
    /// Whoever asked has said so.
    #[error("stopped")]
    Stopped,
}

impl CaptureError {
    pub(super) fn internal(what: impl Into<String>, source: std::io::Error) -> Self {
        CaptureError::Internal { what: what.into(), source }
    }

    /// What is wrong with the input, where it is the input.
    pub fn bad_input(&self) -> Option<&BadInput> {
        match self {
            CaptureError::Bad(bad) => Some(bad),
            CaptureError::Internal { .. } | CaptureError::Stopped => None,
        }
    }
}
