//! How well an avatar matches the truth: image, mask, surface and joint errors against a folder of truth.

mod flip;
mod geometry;
mod image;
mod lpips;
mod nearest;
mod page;
mod refine;
mod report;
mod run;
mod shot;
mod subject;

pub use self::flip::flip_map;
pub use self::geometry::{Distances, Similarity, align, distances, sample, umeyama};
pub use self::image::{mask_iou, psnr, psnr_inside, ssim, ssim_inside};
pub use self::lpips::{Lpips, LpipsError};
pub use nearest::Surface;
pub use report::{FrameIou, GeometryScore, ImageFigures, ImageScore, JointScore, Report, Summary};
pub use run::{EvalError, EvalOptions, evaluate};
pub use subject::{Novel, NovelPose, Subject, SubjectError};
