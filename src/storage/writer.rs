//! Bytes on their way into a file of the data folder, which leave the disk's reserve alone.

use std::io;

use tokio::io::{AsyncWriteExt, BufWriter};

use super::Store;

/// Large writes: each costs a hop to a blocking thread.
const BUFFER_BYTES: usize = 1 << 20;
/// The disk is asked for room before each such stretch of a file.
const LOOK_BYTES: u64 = 16 << 20;

/// A file that is being written.
pub struct Writer {
    store: Store,
    file: BufWriter<tokio::fs::File>,
    end: u64,
    /// Up to here the disk was found to have room.
    looked: u64,
}

impl Writer {
    /// Goes on with a file that stands at `end`.
    pub(super) fn new(store: &Store, file: tokio::fs::File, end: u64) -> Self {
        Self { store: store.clone(), file: BufWriter::with_capacity(BUFFER_BYTES, file), end, looked: 0 }
    }

    /// An error of kind `StorageFull` where the disk's reserve would be touched.
    pub async fn write(&mut self, chunk: &[u8]) -> io::Result<()> {
        let end = self.end + chunk.len() as u64;
        if end > self.looked {
            self.looked = self.end + LOOK_BYTES;
            if !self.store.has_room(chunk.len() as u64) {
                return Err(io::ErrorKind::StorageFull.into());
            }
        }
        self.file.write_all(chunk).await?;
        self.end = end;
        Ok(())
    }

    /// The bytes that the file has, those in the buffer among them.
    pub fn bytes(&self) -> u64 {
        self.end
    }

    /// Empties the buffer.
    pub(super) async fn flush(&mut self) -> io::Result<()> {
        self.file.flush().await
    }

    /// Flushes the file to the disk; returns its size.
    pub async fn finish(mut self) -> io::Result<u64> {
        self.flush().await?;
        self.file.get_ref().sync_all().await?;
        Ok(self.end)
    }
}
