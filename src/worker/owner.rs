//! Who holds a lease, and whether it lives.
//!
//! Each worker process keeps an exclusive lock on a file of its own; the kernel lets go of it when the process ends, by
//! whatever cause. A stopped process keeps its lock: only time takes its leases.

use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

use uuid::Uuid;

/// The id of this worker, with its lock.
#[derive(Debug)]
pub struct Owner {
    id: String,
    path: PathBuf,
    _lock: File,
}

impl Owner {
    pub fn new(folder: &Path, id: Uuid) -> io::Result<Owner> {
        let id = id.to_string();
        let path = lock_path(folder, &id);
        loop {
            let lock = File::create_new(&path)?;
            lock.lock()?;
            // Somebody may have taken the file for a dead worker's before it was locked.
            if path.exists() {
                return Ok(Owner { id, path, _lock: lock });
            }
        }
    }

    pub fn id(&self) -> &str {
        &self.id
    }

    /// Whether the worker of this id is certainly gone; what it left is removed then.
    pub fn remove_if_dead(folder: &Path, id: &str) -> io::Result<bool> {
        let path = lock_path(folder, id);
        let file = match File::open(&path) {
            Ok(file) => file,
            // The lock comes before the first claim and goes after the last lease.
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(true),
            Err(error) => return Err(error),
        };
        match file.try_lock() {
            Ok(()) => match fs::remove_file(&path) {
                // A worker that ended in this moment removes its own.
                Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
                _ => Ok(true),
            },
            Err(TryLockError::WouldBlock) => Ok(false),
            Err(TryLockError::Error(error)) => Err(error),
        }
    }
}

/// Removes the locks of workers that are gone, also of those that died without a job.
pub fn sweep(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let name = entry?.file_name();
        if let Some(id) = name.to_str().and_then(|name| name.strip_suffix(".lock")) {
            Owner::remove_if_dead(folder, id)?;
        }
    }
    Ok(())
}

impl Drop for Owner {
    fn drop(&mut self) {
        // One that stays is found dead later.
        let _ = fs::remove_file(&self.path);
    }
}

fn lock_path(folder: &Path, id: &str) -> PathBuf {
    folder.join(format!("{id}.lock"))
}
