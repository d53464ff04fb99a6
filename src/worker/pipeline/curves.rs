//! The losses of a job over its steps. They lie beside the checkpoint, so that a job that goes on from there shows them from the
//! beginning; the fit itself does not need them.

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

#[derive(Debug)]
pub(super) struct Curves {
    file: PathBuf,
    points: Vec<Point>,
    /// Until they are loaded what lies in the file stays.
    loaded: bool,
}

impl Curves {
    /// None so far; `work_dir` holds the checkpoints.
    pub fn new(work_dir: &Path) -> Self {
        Self { file: work_dir.join("losses.json"), points: Vec::new(), loaded: false }
    }

    pub fn points(&self) -> &[Point] {
        &self.points
    }

    /// Goes on with what was saved.
    pub fn load(&mut self) {
        let saved = std::fs::read(&self.file).ok().and_then(|json| serde_json::from_slice(&json).ok());
        (self.points, self.loaded) = (saved.unwrap_or_default(), true);
    }

    /// Forgets what comes after a step, since it will come again: the file may be ahead of the checkpoint, or of an earlier fit.
    pub fn cut(&mut self, stage: Stage, step: u32) {
        self.points.retain(|point| (point.stage, point.step) <= (stage, step));
    }

    pub fn push(&mut self, stage: Stage, step: u32, losses: &BTreeMap<String, f64>) {
        self.points.push(Point { stage, step, losses: losses.clone() });
    }

    /// A report with shorter curves is worth more than none: what goes wrong is logged.
    pub fn save(&self) {
        if !self.loaded {
            return;
        }
        let json = serde_json::to_vec(&self.points).expect("numbers and names");
        if let Err(error) = crate::storage::write_atomic(&self.file, &json) {
            tracing::warn!(%error, "the losses are not kept");
        }
    }
}
