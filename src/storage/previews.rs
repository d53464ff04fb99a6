//! Pictures of an avatar in the making. Each has a name of its own and never changes; names rise, so that a worker which
//! lost its lease can neither replace nor remove the pictures of the next one.

use std::fs;
use std::io;
use std::path::PathBuf;

use uuid::Uuid;

use super::{Store, names};
use crate::atomic_file;

impl Store {
    pub fn previews(&self, job: Uuid) -> PathBuf {
        self.job(job).join("previews")
    }

    /// Name of the `nth` picture of the attempt with this epoch.
    pub fn preview_name(epoch: i64, nth: u32) -> String {
        format!("{epoch:06}-{nth:06}.jpg")
    }

    /// Writes a picture. Fails where the job's folder is gone, rather than to make it anew.
    pub fn put_preview(&self, job: Uuid, name: &str, jpeg: &[u8]) -> io::Result<()> {
        let folder = self.previews(job);
        match fs::create_dir(&folder) {
            Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(error),
            _ => {}
        }
        atomic_file::write(&folder.join(name), jpeg)
    }

    /// Removes the pictures before the named one.
    pub fn drop_previews_before(&self, job: Uuid, name: &str) -> io::Result<()> {
        let folder = self.previews(job);
        for older in names(&folder)?.iter().filter(|found| found.as_str() < name) {
            fs::remove_file(folder.join(older))?;
        }
        Ok(())
    }

    /// Removes a picture that the queue did not take.
    pub fn drop_preview(&self, job: Uuid, name: &str) -> io::Result<()> {
        fs::remove_file(self.previews(job).join(name))
    }
}
