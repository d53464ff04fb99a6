//! What was wrong with a clip, and what the fit could not do with it: flags with a stable code, the frames they are about, a
//! number against its limit, and what to do so that the next clip is better. docs/quality.md lists them.

mod clip;
mod fit;
mod flag;
mod mask;
mod mask_edge;
mod sharpness;
mod surface;

pub use clip::{FrameMeasures, clip_flags, edge_offsets, measure};
pub use fit::{ContradictedFocal, ContradictedPoses, FitFindings, fit_flags, turn_coverage_degrees};
pub use flag::{Flag, KINDS, Kind};
pub use mask_edge::settle_masks;
pub use surface::{SurfaceCheck, check_surface, surface_flags};
