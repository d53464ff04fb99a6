//! Copies of the store's files. What the store holds under a name never changes, so a hard link is a copy; where the
//! backup lies on another file system, the bytes are copied.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use uuid::Uuid;

use super::{Store, names};
use crate::atomic_file::sync_dir;

/// How much was copied.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Copied {
    pub files: u64,
    pub bytes: u64,
}

impl std::ops::AddAssign for Copied {
    fn add_assign(&mut self, other: Copied) {
        self.files += other.files;
        self.bytes += other.bytes;
    }
}

/// How a file gets from one place to the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum How {
    /// By a second name for the same bytes, where the file system can.
    Link,
    /// By new bytes, on the disk when the copy is reported.
    Copy,
}

impl Store {
    /// Copies the body models.
    pub fn copy_bodies(&self, to: &Store, how: How) -> io::Result<Copied> {
        copy_folder(&self.bodies(), &to.bodies(), how)
    }

    /// Copies a job's inputs, checkpoints, preview and published results. Files that vanish meanwhile are left out.
    pub fn copy_job(&self, to: &Store, job: Uuid, published: Option<i64>, how: How) -> io::Result<Copied> {
        let mut copied = copy_folder(&self.inputs(job), &to.inputs(job), how)?;
        copied += copy_folder(&self.work(job), &to.work(job), how)?;
        copied += copy_folder(&self.previews(job), &to.previews(job), how)?;
        if let Some(epoch) = published {
            copied += copy_folder(&self.results(job, epoch), &to.results(job, epoch), how)?;
        }
        Ok(copied)
    }

    /// The first of the named files of a job that is missing or has another size.
    pub fn missing(&self, folder: &Path, files: impl Iterator<Item = (String, u64)>) -> Option<PathBuf> {
        let mut paths = files.map(|(name, bytes)| (folder.join(name), bytes));
        paths.find(|(path, bytes)| !fs::metadata(path).is_ok_and(|found| found.len() == *bytes)).map(|(path, _)| path)
    }
}

fn copy_folder(from: &Path, to: &Path, how: How) -> io::Result<Copied> {
    let mut copied = Copied::default();
    for name in names(from)? {
        let (source, target) = (from.join(&name), to.join(&name));
        match copy_entry(&source, &target, how) {
            Ok(more) => copied += more,
            // A job that is deleted, or a checkpoint that is replaced, while it is looked at.
            Err(error) if error.kind() == io::ErrorKind::NotFound && !source.exists() => {}
            Err(error) => return Err(io::Error::new(error.kind(), format!("{}: {error}", source.display()))),
        }
    }
    if how == How::Copy && to.exists() {
        sync_dir(to)?;
    }
    Ok(copied)
}

fn copy_entry(source: &Path, target: &Path, how: How) -> io::Result<Copied> {
    if source.is_dir() {
        return copy_folder(source, target, how);
    }
    if let Some(folder) = target.parent() {
        fs::create_dir_all(folder)?;
    }
    // One that an interrupted attempt left.
    match fs::remove_file(target) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    if how == How::Copy || fs::hard_link(source, target).is_err() {
        fs::copy(source, target)?;
        fs::File::open(target)?.sync_all()?;
    }
    Ok(Copied { files: 1, bytes: fs::metadata(target)?.len() })
}
