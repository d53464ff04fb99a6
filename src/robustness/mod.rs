//! What a fit makes of spoiled clips: a clip with truth is perturbed, mostly in one way at a time, fitted as a process of its own,
//! evaluated against the unspoiled truth, and compared with the clean clip (docs/robustness.md); and clips are made as people
//! film them (docs/filming.md).

mod cases;
mod document;
mod footage;
mod hand;
mod images;
mod keypoints;
mod masks;
mod run;
mod takes;

pub use cases::{CASES, Case};
pub use document::{Comparison, document, sheet};
pub use footage::Footage;
pub use run::{Outcome, Settings, Status, run};
pub use takes::{TAKES, Take};
