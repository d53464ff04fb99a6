//! What a fit makes of spoiled clips: a clip with truth is perturbed in one way at a time, fitted as a process of its own,
//! evaluated against the unspoiled truth, and compared with the clean clip. docs/robustness.md is written from the results.

mod cases;
mod document;
mod footage;
mod images;
mod keypoints;
mod masks;
mod run;

pub use cases::{CASES, Case};
pub use document::{document, sheet};
pub use footage::Footage;
pub use run::{Outcome, Settings, Status, run};
