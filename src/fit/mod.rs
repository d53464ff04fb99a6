//! The fit of a body and its looks to a clip.

pub mod stage0;
