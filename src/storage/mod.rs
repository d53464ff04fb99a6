//! Blobs on local files.
//!
//! ```text
//! <data>/effigy.db            the queue
//! <data>/bodies/              body models
//! <data>/jobs/<job>/inputs/   the uploaded parts; complete before the job is in the queue
//! <data>/jobs/<job>/work/     checkpoints and the losses so far, which outlive a worker
//! <data>/jobs/<job>/previews/ the newest picture of the avatar as it emerges
//! <data>/jobs/<job>/results/<epoch>/   what an attempt made; the published epoch is in the database
//! <data>/uploads/             uploads that come in pieces, until a job uses them
//! <data>/renders/             answers of the worker on their way to a client
//! <data>/tmp/                 uploads on their way in, deletions on their way out; emptied at start
//! <data>/workers/             a locked file for each live worker process
//! <data>/ballast              bytes that a deletion may give up on a full disk
//! ```
//!
//! Whatever appears under its name is complete and on the disk: files are written in `tmp`, flushed, and renamed.

mod backup;
mod previews;
mod publish;
mod resumable;
mod serve;
mod space;
mod upload;
mod writer;

use std::collections::HashSet;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tokio::sync::Mutex;
use uuid::Uuid;

use crate::atomic_file::sync_dir;
use crate::data_dir;

pub use backup::{Copied, How};
pub use publish::Published;
pub use resumable::{AboutUpload, Appender, ResumableUpload};
pub use serve::{ByteRange, open_range, parse_range};
pub use upload::Upload;
pub use writer::Writer;

/// The data folder.
#[derive(Clone, Debug)]
pub struct Store {
    root: PathBuf,
    reserve_bytes: u64,
    /// Held while the ballast is given up for something.
    ballast: Arc<Mutex<()>>,
}

impl Store {
    /// What belongs together, for people who move it: rows without their files are as useless as the other way round.
    pub const OF_THE_QUEUE: &str = "effigy.db, effigy.db-wal, effigy.db-shm and jobs";

    /// Makes the folders that are missing.
    pub fn open(root: &Path) -> io::Result<Store> {
        data_dir::create(root)?;
        let store = Store { root: root.canonicalize()?, reserve_bytes: 0, ballast: Arc::default() };
        for folder in [store.tmp(), store.jobs(), store.bodies(), store.renders(), store.workers(), store.uploads()] {
            fs::create_dir_all(folder)?;
        }
        Ok(store)
    }

    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Whether all users of this machine can read the database, or could read one that is made.
    #[cfg(unix)]
    pub fn is_open_to_all(&self) -> bool {
        use std::os::unix::fs::PermissionsExt;
        let lets =
            |path: &Path, bits: u32| fs::metadata(path).is_ok_and(|meta| meta.permissions().mode() & bits == bits);
        self.root.ancestors().all(|folder| lets(folder, 0o001))
            && (!self.database().exists() || lets(&self.database(), 0o004))
    }

    #[cfg(not(unix))]
    pub fn is_open_to_all(&self) -> bool {
        false
    }

    pub fn database(&self) -> PathBuf {
        self.root.join("effigy.db")
    }

    /// The database with its journal and the index of that, which a server that was killed leaves behind.
    pub fn database_files(&self) -> [PathBuf; 3] {
        ["effigy.db", "effigy.db-wal", "effigy.db-shm"].map(|name| self.root.join(name))
    }

    pub fn bodies(&self) -> PathBuf {
        self.root.join("bodies")
    }

    /// Names of the body models, sorted.
    pub fn body_names(&self) -> io::Result<Vec<String>> {
        let mut found = names(&self.bodies())?;
        found.retain_mut(|name| match name.strip_suffix(".body.npz") {
            Some(stem) => {
                *name = stem.to_string();
                true
            }
            None => false,
        });
        found.sort();
        Ok(found)
    }

    pub fn renders(&self) -> PathBuf {
        self.root.join("renders")
    }

    pub fn workers(&self) -> PathBuf {
        self.root.join("workers")
    }

    pub fn inputs(&self, job: Uuid) -> PathBuf {
        self.job(job).join("inputs")
    }

    /// Where an attempt keeps what the next one goes on from.
    pub fn work(&self, job: Uuid) -> PathBuf {
        self.job(job).join("work")
    }

    pub fn results(&self, job: Uuid, epoch: i64) -> PathBuf {
        self.job(job).join("results").join(epoch.to_string())
    }

    fn job(&self, job: Uuid) -> PathBuf {
        self.jobs().join(job.to_string())
    }

    fn jobs(&self) -> PathBuf {
        self.root.join("jobs")
    }

    fn tmp(&self) -> PathBuf {
        self.root.join("tmp")
    }

    /// Begins an upload: a folder in `tmp` that vanishes unless it is committed.
    pub fn begin_upload(&self) -> io::Result<Upload> {
        Upload::begin(self.clone(), self.tmp().join(format!("upload-{}", Uuid::new_v4())))
    }

    /// Gives the uploaded parts to a job: they appear at once and whole, on the disk.
    pub fn commit_upload(&self, upload: Upload, job: Uuid) -> io::Result<()> {
        let inputs = self.inputs(job);
        fs::create_dir_all(self.job(job))?;
        upload.move_to(&inputs)?;
        sync_dir(&self.job(job))?;
        sync_dir(&self.jobs())
    }

    /// Removes all files of a job. They vanish at once, by a rename; a crash leaves nothing that looks like a job.
    pub fn delete_job(&self, job: Uuid) -> io::Result<()> {
        let grave = self.tmp().join(format!("deleted-{}", Uuid::new_v4()));
        match fs::rename(self.job(job), &grave) {
            Ok(()) => fs::remove_dir_all(grave),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
            Err(error) => Err(error),
        }
    }

    /// Removes checkpoints and all results but the published ones.
    pub fn tidy_job(&self, job: Uuid, published: Option<i64>) -> io::Result<()> {
        remove_dir(&self.work(job))?;
        let results = self.job(job).join("results");
        for name in names(&results)? {
            if published.map(|epoch| epoch.to_string()).as_deref() != Some(&name) {
                remove_dir(&results.join(name))?;
            }
        }
        Ok(())
    }

    /// Removes what one attempt made.
    pub fn discard_results(&self, job: Uuid, epoch: i64) -> io::Result<()> {
        remove_dir(&self.results(job, epoch))
    }

    /// Removes what a killed server left half-written: uploads, deletions and renders on their way, and folders of
    /// jobs that never reached the queue. Only while no other server uses the folder.
    pub fn clean(&self, known: &HashSet<Uuid>) -> io::Result<()> {
        for folder in [self.tmp(), self.renders()] {
            for name in names(&folder)? {
                let path = folder.join(name);
                if path.is_dir() { fs::remove_dir_all(path)? } else { fs::remove_file(path)? }
            }
        }
        for name in names(&self.jobs())? {
            if let Ok(id) = name.parse::<Uuid>()
                && !known.contains(&id)
            {
                self.delete_job(id)?;
            }
        }
        Ok(())
    }

    /// Makes this process the folder's only server for as long as the lock lives; None where there is one already.
    pub fn lock_server(&self) -> io::Result<Option<File>> {
        let lock = File::create(self.root.join("serve.lock"))?;
        match lock.try_lock() {
            Ok(()) => Ok(Some(lock)),
            Err(fs::TryLockError::WouldBlock) => Ok(None),
            Err(fs::TryLockError::Error(error)) => Err(error),
        }
    }

    /// Jobs that have a folder.
    pub fn job_folders(&self) -> io::Result<Vec<Uuid>> {
        Ok(names(&self.jobs())?.iter().filter_map(|name| name.parse().ok()).collect())
    }
}

/// Entries of a folder; none where there is no such folder.
fn names(folder: &Path) -> io::Result<Vec<String>> {
    match fs::read_dir(folder) {
        Ok(entries) => entries.map(|entry| Ok(entry?.file_name().to_string_lossy().into_owned())).collect(),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Vec::new()),
        Err(error) => Err(error),
    }
}

fn remove_dir(path: &Path) -> io::Result<()> {
    match fs::remove_dir_all(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests;
