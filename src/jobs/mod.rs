//! Jobs: what they are, which states they go through, and the queue that keeps them.
//!
//! The schema in `migrations/` tells the domain; this module gives it types. [`Queue`] is the only way to the
//! database; [`sqlite`] implements it. Time and chance come in through [`Env`], so that tests own both.

mod clock;
#[cfg(test)]
pub(crate) mod conformance;
mod env;
mod job;
pub mod keys;
mod leaps;
mod options;
mod queue;
pub mod render;
pub mod sqlite;
mod timestamp;
pub mod webhooks;

pub use clock::{Clock, ManualClock, Steady, SystemClock};
pub use env::Env;
pub use job::{
    Avatar, AvatarFile, Clip, Event, EventKind, Insertion, Job, JobError, Losses, NewAvatar, NewJob, Part, Remember,
    Remembered, State,
};
pub use leaps::Leaps;
pub use options::{JobOptions, Preset};
pub use queue::{
    Change, Deletion, Figures, Lease, ListFilter, Policy, ProgressReport, Queue, QueueError, Reaped, Repeat, StageTime,
    Standing,
};
pub use timestamp::Timestamp;
