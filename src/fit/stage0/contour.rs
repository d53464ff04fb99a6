//! The mask's edge as evidence.

use super::{Candidate, Stage0Error, Stage0Report};
use crate::body::Body;
use crate::capture::Capture;

pub const ROUNDS: usize = 0;

pub fn refine(
    _best: &mut Candidate,
    _body: &Body,
    _capture: &Capture,
    _iterations: usize,
    _report: &mut Stage0Report,
    _go_on: &mut dyn FnMut() -> bool,
) -> Result<(), Stage0Error> {
    Ok(())
}
