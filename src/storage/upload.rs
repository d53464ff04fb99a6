//! Parts on their way in.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::{Store, Writer};
use crate::atomic_file::sync_dir;

/// A folder of parts that vanishes when it is dropped before it is committed.
pub struct Upload {
    store: Store,
    folder: PathBuf,
    committed: bool,
}

impl Upload {
    pub(super) fn begin(store: Store, folder: PathBuf) -> io::Result<Upload> {
        fs::create_dir(&folder)?;
        Ok(Upload { store, folder, committed: false })
    }

    /// Where the parts are, each under its name.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    fn path(&self, part: &str) -> PathBuf {
        self.folder.join(part)
    }

    /// Opens a part for writing. `part` is a plain file name of ours, never the client's.
    pub async fn part(&self, part: &str) -> io::Result<Writer> {
        Ok(Writer::new(&self.store, tokio::fs::File::create_new(self.path(part)).await?, 0))
    }

    /// Takes a finished resumable upload as a part, without a copy: it stays until it is removed.
    pub fn adopt(&self, part: &str, upload: uuid::Uuid) -> io::Result<()> {
        fs::hard_link(self.store.resumable_data(upload), self.path(part))
    }

    pub(super) fn move_to(mut self, to: &Path) -> io::Result<()> {
        sync_dir(&self.folder)?;
        fs::rename(&self.folder, to)?;
        self.committed = true;
        Ok(())
    }
}

impl Drop for Upload {
    fn drop(&mut self) {
        if !self.committed
            && let Err(error) = fs::remove_dir_all(&self.folder)
        {
            tracing::warn!(folder = %self.folder.display(), %error, "an abandoned upload stays until the next start");
        }
    }
}
