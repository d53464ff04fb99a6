//! The paper's claims as experiments: a study states a claim, measures, and says from the numbers whether it holds.
//!
//! One file a study. Each has a `Settings` whose default is what docs/results.md shows; tests run smaller ones. A study's
//! text tells what was done; what came out is computed ([`Verdict`]).

pub mod ablation;
mod context;
pub mod cost;
pub mod cube;
mod document;
mod made_clip;
mod objective;
mod painter;
mod person;
pub mod pose;
mod report;
pub mod silhouettes;
pub mod stages;
pub mod texture;

use anyhow::Result;

pub use context::Context;
pub use document::document;
pub use report::{Column, Figure, Report, Row, Saved, Table, Verdict};

/// An experiment on one claim.
pub struct Study {
    /// The name on the command line and of the files.
    pub name: &'static str,
    /// The heading in the document.
    pub title: &'static str,
    /// What the paper says.
    pub claim: &'static str,
    /// Where it says so.
    pub section: &'static str,
    /// How it is measured here and what to keep in mind; no results.
    pub method: &'static str,
    pub run: fn(&Context<'_>) -> Result<Report>,
}

/// All studies in the document's order.
pub const STUDIES: &[Study] =
    &[cube::STUDY, pose::STUDY, stages::STUDY, silhouettes::STUDY, texture::STUDY, ablation::STUDY, cost::STUDY];

/// The study of this name.
pub fn study(name: &str) -> Option<&'static Study> {
    STUDIES.iter().find(|study| study.name == name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_and_fit_for_files() {
        let mut seen = std::collections::BTreeSet::new();
        for s in STUDIES {
            assert!(s.name.chars().all(|c| c.is_ascii_lowercase() || c == '-'), "{}", s.name);
            assert!(seen.insert(s.name), "{} stands twice", s.name);
            assert!(study(s.name).is_some_and(|found| found.title == s.title));
        }
        assert!(study("nothing").is_none());
    }
}
