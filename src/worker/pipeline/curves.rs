//! The losses of a job over its steps, and the time that its stages took. They lie beside the checkpoint, so that a job that goes on
//! from there shows them from the beginning; the fit itself does not need them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::Stage;

/// Mean losses a frame at a step of a stage.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub(super) struct Point {
    pub stage: Stage,
    pub step: u32,
    pub losses: BTreeMap<String, f64>,
}

/// Seconds that each stage took.
pub(super) type StageSecs = BTreeMap<String, f64>;

/// The file.
#[derive(Default, serde::Serialize, serde::Deserialize)]
struct Kept {
    points: Vec<Point>,
    secs: StageSecs,
}

#[derive(Debug)]
pub(super) struct Curves {
    file: PathBuf,
    points: Vec<Point>,
    /// Of attempts before this one.
    secs_before: StageSecs,
    /// Until they are loaded what lies in the file stays.
    loaded: bool,
}

impl Curves {
    /// None so far; `work_dir` holds the checkpoints.
    pub fn new(work_dir: &Path) -> Self {
        Self { file: work_dir.join("losses.json"), points: Vec::new(), secs_before: StageSecs::new(), loaded: false }
    }

    pub fn points(&self) -> &[Point] {
        &self.points
    }

    /// Goes on with what was saved.
    pub fn load(&mut self) {
        let saved = std::fs::read(&self.file).ok().and_then(|json| serde_json::from_slice(&json).ok());
        let saved: Kept = saved.unwrap_or_default();
        (self.points, self.secs_before, self.loaded) = (saved.points, saved.secs, true);
    }

    /// The time of all attempts, of which this one has taken `secs`.
    pub fn whole(&self, secs: &StageSecs) -> StageSecs {
        let mut whole = self.secs_before.clone();
        secs.iter().for_each(|(stage, secs)| *whole.entry(stage.clone()).or_default() += secs);
        whole
    }

    /// Forgets what comes after a step, since it will come again: the file may be ahead of the checkpoint, or of an earlier fit.
    pub fn cut(&mut self, stage: Stage, step: u32) {
        self.points.retain(|point| (point.stage, point.step) <= (stage, step));
    }

    pub fn push(&mut self, stage: Stage, step: u32, losses: &BTreeMap<String, f64>) {
        self.points.push(Point { stage, step, losses: losses.clone() });
    }

    /// With the `secs` of this attempt. A report with shorter curves is worth more than none: what goes wrong is logged.
    pub fn save(&self, secs: &StageSecs) {
        if !self.loaded {
            return;
        }
        let kept = Kept { points: self.points.clone(), secs: self.whole(secs) };
        let json = serde_json::to_vec(&kept).expect("numbers and names");
        if let Err(error) = crate::atomic_file::write(&self.file, &json) {
            tracing::warn!(%error, "the losses are not kept");
        }
    }
}
