//! How well an avatar matches the truth: image, mask, surface and joint errors against a folder of truth.

mod geometry;
mod image;
mod nearest;
mod report;
mod run;
mod subject;
mod synth;

pub use self::geometry::{Distances, Similarity, align, distances, sample, umeyama};
pub use self::image::{mask_iou, psnr, ssim};
pub use nearest::Surface;
pub use report::{FrameIou, GeometryScore, ImageScore, JointScore, Report, Summary};
pub use run::{EvalError, evaluate};
pub use subject::{Novel, NovelPose, Subject, SubjectError};
pub use synth::{Outfit, SynthError, SynthOptions, synthesise};
