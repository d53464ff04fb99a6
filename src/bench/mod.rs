//! What `effigy bench` and `benches/` time: operators on one frame, steps, pictures, the device's own limits, and what the
//! work needs at least.

mod ceilings;
mod frame;
mod person;
mod picture;
mod scale;
mod step;
mod timing;

pub use ceilings::{Ceilings, Peaks};
pub use frame::Frame;
pub use picture::{PictureBench, PictureTimes};
pub use scale::{Counts, Scale};
pub use step::{Row, Step, StepBench, StepTimes};
pub use timing::{Times, cores, interleaved, timed};

use crate::gpu::Recorder;

/// One thing to time, with what its contract cannot do without.
pub struct Case<'a> {
    pub name: &'static str,
    pub needs: Counts,
    pub record: Box<dyn Fn(&mut Recorder<'_>) + 'a>,
}
