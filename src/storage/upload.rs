//! Parts on their way in.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use tokio::io::{AsyncWriteExt, BufWriter};

use super::Store;
use crate::atomic_file::sync_dir;

/// Large writes: each costs a hop to a blocking thread.
const BUFFER_BYTES: usize = 1 << 20;
/// The disk is asked for room before each such stretch of a part.
const LOOK_BYTES: u64 = 16 << 20;

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

    pub fn path(&self, part: &str) -> PathBuf {
        self.folder.join(part)
    }

    /// Opens a part for writing. `part` is a plain file name of ours, never the client's.
    pub async fn part(&self, part: &str) -> io::Result<PartWriter> {
        let file = tokio::fs::File::create_new(self.path(part)).await?;
        let file = BufWriter::with_capacity(BUFFER_BYTES, file);
        Ok(PartWriter { store: self.store.clone(), file, bytes: 0, looked: 0 })
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

/// A part that is being written.
pub struct PartWriter {
    store: Store,
    file: BufWriter<tokio::fs::File>,
    bytes: u64,
    /// Up to here the disk was found to have room.
    looked: u64,
}

impl PartWriter {
    /// An error of kind `StorageFull` where the disk's reserve would be touched.
    pub async fn write(&mut self, chunk: &[u8]) -> io::Result<()> {
        if self.bytes + chunk.len() as u64 > self.looked {
            self.looked = self.bytes + LOOK_BYTES;
            if !self.store.has_room(chunk.len() as u64) {
                return Err(io::ErrorKind::StorageFull.into());
            }
        }
        self.file.write_all(chunk).await?;
        self.bytes += chunk.len() as u64;
        Ok(())
    }

    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Flushes the part to the disk; returns its size.
    pub async fn finish(mut self) -> io::Result<u64> {
        self.file.flush().await?;
        self.file.get_ref().sync_all().await?;
        Ok(self.bytes)
    }
}
