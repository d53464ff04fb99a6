//! Uploads that come in pieces, and outlive the connection and the server that they came through.
//!
//! ```text
//! <data>/uploads/<id>/about.json    length and metadata; written once
//! <data>/uploads/<id>/data          what has come so far: its length is the offset
//! <data>/uploads/<id>/unverified    while a piece with a checksum comes: the offset before it
//! ```

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use serde::{Deserialize, Serialize};
use tokio::io::AsyncSeekExt;
use uuid::Uuid;

use super::{Store, Writer, names};
use crate::atomic_file::{self, sync_dir};

/// Clocks of files are coarser than the system's.
const MARGIN: Duration = Duration::from_secs(1);

/// What a client told of an upload when it began it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AboutUpload {
    pub bytes: u64,
    /// As the client wrote it.
    pub metadata: Option<String>,
    /// The API key that it came with.
    pub owner: Option<Uuid>,
}

/// An upload as it stands.
#[derive(Clone, Debug)]
pub struct ResumableUpload {
    pub id: Uuid,
    pub about: AboutUpload,
    /// So much has come.
    pub offset: u64,
    /// When something last came.
    pub touched: SystemTime,
}

impl ResumableUpload {
    pub fn is_whole(&self) -> bool {
        self.offset == self.about.bytes
    }
}

impl Store {
    pub(super) fn uploads(&self) -> PathBuf {
        self.root.join("uploads")
    }

    fn resumable_folder(&self, id: Uuid) -> PathBuf {
        self.uploads().join(id.to_string())
    }

    /// Where the bytes of an upload are.
    pub fn resumable_data(&self, id: Uuid) -> PathBuf {
        self.resumable_folder(id).join("data")
    }

    /// Begins an upload: it is there whole or not at all.
    pub fn begin_resumable(&self, id: Uuid, about: &AboutUpload) -> io::Result<()> {
        let making = self.tmp().join(format!("resumable-{id}"));
        fs::create_dir(&making)?;
        atomic_file::write(&making.join("about.json"), &serde_json::to_vec(about)?)?;
        fs::File::create_new(making.join("data"))?.sync_all()?;
        sync_dir(&making)?;
        fs::rename(&making, self.resumable_folder(id))?;
        sync_dir(&self.uploads())
    }

    /// What was told of an upload at its beginning.
    pub fn about_resumable(&self, id: Uuid) -> io::Result<Option<AboutUpload>> {
        match fs::read(self.resumable_folder(id).join("about.json")) {
            Ok(about) => Ok(Some(serde_json::from_slice(&about)?)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// An upload; None where there is none of this id. Not while a piece of it comes: what a killed server left
    /// unverified is cut off.
    pub fn resumable(&self, id: Uuid) -> io::Result<Option<ResumableUpload>> {
        let folder = self.resumable_folder(id);
        let Some(about) = self.about_resumable(id)? else { return Ok(None) };
        cut_unverified(&folder)?;
        let data = folder.join("data").metadata()?;
        Ok(Some(ResumableUpload { id, about, offset: data.len(), touched: data.modified()? }))
    }

    /// All uploads, with the bytes of each that have come.
    pub fn open_resumables(&self) -> io::Result<Vec<(AboutUpload, u64)>> {
        let mut open = Vec::new();
        for id in self.resumable_ids()? {
            if let Some(about) = self.about_resumable(id)? {
                // One that is removed meanwhile has nothing.
                let came = self.resumable_data(id).metadata().map_or(0, |data| data.len());
                open.push((about, came));
            }
        }
        Ok(open)
    }

    pub fn resumable_ids(&self) -> io::Result<Vec<Uuid>> {
        Ok(names(&self.uploads())?.iter().filter_map(|name| name.parse().ok()).collect())
    }

    /// When something last came for an upload.
    pub fn resumable_touched(&self, id: Uuid) -> io::Result<SystemTime> {
        self.resumable_data(id).metadata()?.modified()
    }

    /// The wall clock has leapt to `now`: what was last touched before that moves along, so that its age stays.
    pub fn move_resumables(&self, leap_ms: i64, now: SystemTime) -> io::Result<()> {
        let leap = Duration::from_millis(leap_ms.unsigned_abs());
        for id in self.resumable_ids()? {
            let data = match fs::File::options().write(true).open(self.resumable_data(id)) {
                Ok(data) => data,
                // A job has used it meanwhile, or its client has given it up.
                Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
                Err(error) => return Err(error),
            };
            let touched = data.metadata()?.modified()?;
            // What has come since the leap has the new clock's time already.
            match leap_ms > 0 {
                true if touched + leap <= now + MARGIN => data.set_modified(touched + leap)?,
                false if touched > now + MARGIN => data.set_modified(touched - leap)?,
                _ => {}
            }
        }
        Ok(())
    }

    /// Removes an upload at once; false where there is none.
    pub fn remove_resumable(&self, id: Uuid) -> io::Result<bool> {
        let grave = self.tmp().join(format!("deleted-{}", Uuid::new_v4()));
        match fs::rename(self.resumable_folder(id), &grave) {
            Ok(()) => fs::remove_dir_all(grave).map(|()| true),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(false),
            Err(error) => Err(error),
        }
    }

    /// Opens an upload for its next piece. Where the piece is to be verified, a crash before that takes it back.
    pub async fn append_resumable(&self, upload: &ResumableUpload, verified: bool) -> io::Result<Appender> {
        let folder = self.resumable_folder(upload.id);
        if verified {
            let (folder, offset) = (folder.clone(), upload.offset);
            let marked = tokio::task::spawn_blocking(move || mark_unverified(&folder, offset));
            marked.await.map_err(io::Error::other)??;
        }
        let mut file = tokio::fs::OpenOptions::new().write(true).open(folder.join("data")).await?;
        // Not the end: a write that was under way when its request was dropped may come yet, and is then written over.
        file.seek(io::SeekFrom::Start(upload.offset)).await?;
        Ok(Appender { folder, data: Writer::new(self, file, upload.offset) })
    }
}

fn mark_unverified(folder: &Path, offset: u64) -> io::Result<()> {
    atomic_file::write(&folder.join("unverified"), offset.to_string().as_bytes())
}

fn cut_unverified(folder: &Path) -> io::Result<()> {
    let mark = folder.join("unverified");
    let offset = match fs::read_to_string(&mark) {
        Ok(offset) => offset.parse::<u64>().map_err(io::Error::other)?,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(error),
    };
    let data = fs::OpenOptions::new().write(true).open(folder.join("data"))?;
    data.set_len(offset)?;
    data.sync_all()?;
    fs::remove_file(mark)?;
    sync_dir(folder)
}

/// A piece of an upload on its way to the disk.
pub struct Appender {
    folder: PathBuf,
    data: Writer,
}

impl Appender {
    /// An error of kind `StorageFull` where the disk's reserve would be touched.
    pub async fn write(&mut self, chunk: &[u8]) -> io::Result<()> {
        self.data.write(chunk).await
    }

    /// Flushes what came to the disk; returns the offset. A marked piece stays unverified.
    pub async fn keep(self) -> io::Result<u64> {
        self.data.finish().await
    }

    /// Flushes a marked piece that was found right.
    pub async fn verify(self) -> io::Result<u64> {
        let Appender { folder, data } = self;
        let offset = data.finish().await?;
        tokio::fs::remove_file(folder.join("unverified")).await?;
        tokio::task::spawn_blocking(move || sync_dir(&folder)).await.map_err(io::Error::other)??;
        Ok(offset)
    }

    /// Takes a marked piece back.
    pub async fn take_back(self) -> io::Result<()> {
        let Appender { folder, mut data } = self;
        // What the buffer still writes comes before the cut.
        let flushed = data.flush().await;
        drop(data);
        tokio::task::spawn_blocking(move || cut_unverified(&folder)).await.map_err(io::Error::other)??;
        flushed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn begin(store: &Store, bytes: u64) -> Uuid {
        let id = Uuid::new_v4();
        store.begin_resumable(id, &AboutUpload { bytes, metadata: Some("name eA==".into()), owner: None }).unwrap();
        id
    }

    #[tokio::test]
    async fn pieces_add_up_and_a_reopened_store_knows_them() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        let id = begin(&store, 6);
        for piece in [b"abc", b"def"] {
            let upload = Store::open(folder.path()).unwrap().resumable(id).unwrap().unwrap();
            assert!(!upload.is_whole());
            let mut appender = store.append_resumable(&upload, false).await.unwrap();
            appender.write(piece).await.unwrap();
            assert_eq!(appender.keep().await.unwrap(), upload.offset + 3);
        }
        let upload = store.resumable(id).unwrap().unwrap();
        assert!(upload.is_whole() && upload.about.metadata.as_deref() == Some("name eA=="));
        assert_eq!(fs::read(store.resumable_data(id)).unwrap(), b"abcdef");
        assert_eq!(store.open_resumables().unwrap(), [(upload.about, 6)]);
        assert!(store.remove_resumable(id).unwrap() && !store.remove_resumable(id).unwrap());
        assert!(store.resumable(id).unwrap().is_none());
    }

    #[tokio::test]
    async fn an_unverified_piece_does_not_survive() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        let id = begin(&store, 9);
        let append = async |piece: &[u8]| {
            let upload = store.resumable(id).unwrap().unwrap();
            let mut appender = store.append_resumable(&upload, true).await.unwrap();
            appender.write(piece).await.unwrap();
            appender
        };
        append(b"abc").await.verify().await.unwrap();
        append(b"xxx").await.take_back().await.unwrap();
        assert_eq!(store.resumable(id).unwrap().unwrap().offset, 3);
        // A crash after the bytes reached the disk.
        append(b"yyy").await.keep().await.unwrap();
        assert_eq!(fs::read(store.resumable_data(id)).unwrap(), b"abcyyy");
        assert_eq!(store.resumable(id).unwrap().unwrap().offset, 3);
        append(b"def").await.verify().await.unwrap();
        assert_eq!(fs::read(store.resumable_data(id)).unwrap(), b"abcdef");
    }

    #[tokio::test]
    async fn a_piece_begins_where_it_was_said_to() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        let id = begin(&store, 6);
        let upload = store.resumable(id).unwrap().unwrap();
        // What a request that was dropped had still under way.
        fs::write(store.resumable_data(id), b"abc").unwrap();
        let mut appender = store.append_resumable(&upload, false).await.unwrap();
        appender.write(b"abcdef").await.unwrap();
        assert_eq!(appender.keep().await.unwrap(), 6);
        assert_eq!(fs::read(store.resumable_data(id)).unwrap(), b"abcdef");
    }

    #[test]
    fn an_upload_that_goes_does_not_keep_the_clocks_leap_from_the_others() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        let id = begin(&store, 6);
        fs::create_dir(store.resumable_folder(Uuid::new_v4())).unwrap();
        let (before, day) = (store.resumable_touched(id).unwrap(), Duration::from_secs(24 * 3600));
        store.move_resumables(day.as_millis() as i64, before + day).unwrap();
        assert_eq!(store.resumable_touched(id).unwrap(), before + day);
    }
}
