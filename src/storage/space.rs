//! Room on the disk: a reserve that new work must leave free, and ballast that makes room for a deletion when there is
//! none at all.

use std::fs::OpenOptions;
use std::future::Future;
use std::io::{self, Seek, SeekFrom, Write};

use super::Store;

/// What a deletion writes to the database's log, with room to spare.
const BALLAST_BYTES: u64 = 4 << 20;

impl Store {
    /// New work must leave so much of the disk free.
    pub fn with_reserve(mut self, bytes: u64) -> Store {
        self.reserve_bytes = bytes;
        self
    }

    pub fn reserve_bytes(&self) -> u64 {
        self.reserve_bytes
    }

    /// Free on the data folder's disk, for this process.
    #[cfg(unix)]
    pub fn free_bytes(&self) -> io::Result<u64> {
        use std::os::unix::ffi::OsStrExt;
        let path = std::ffi::CString::new(self.root.as_os_str().as_bytes())?;
        // SAFETY: an all-zero statvfs is a valid value of numbers, which the call overwrites.
        let mut found: libc::statvfs = unsafe { std::mem::zeroed() };
        // SAFETY: both pointers are to live values, the path ends with a zero.
        if unsafe { libc::statvfs(path.as_ptr(), &mut found) } != 0 {
            return Err(io::Error::last_os_error());
        }
        #[allow(clippy::unnecessary_cast, reason = "the fields' types differ between systems")]
        Ok((found.f_bavail as u64).saturating_mul(found.f_frsize as u64))
    }

    #[cfg(not(unix))]
    pub fn free_bytes(&self) -> io::Result<u64> {
        Ok(u64::MAX)
    }

    /// Whether so many bytes can come and the reserve stays free.
    pub fn has_room(&self, bytes: u64) -> bool {
        // A system that cannot tell tells when a write fails.
        self.free_bytes().map_or(true, |free| free >= self.reserve_bytes.saturating_add(bytes))
    }

    /// Puts the ballast (back) in place, as far as there is room for it. Real bytes: a hole would keep nothing free.
    pub fn load_ballast(&self) -> io::Result<()> {
        let there = self.ballast_file().metadata().map_or(0, |meta| meta.len());
        // It is what the reserve is for: a deletion takes little of it, and frees what it can be filled from.
        let missing = BALLAST_BYTES.saturating_sub(there).min(self.free_bytes()?);
        if missing == 0 {
            return Ok(());
        }
        // Two that load at once write the same bytes.
        let mut file = OpenOptions::new().create(true).write(true).truncate(false).open(self.ballast_file())?;
        file.seek(SeekFrom::Start(there))?;
        file.write_all(&vec![0x5a; missing as usize])?;
        file.sync_all()
    }

    /// The same where nobody waits for it; not while this process gives it up for something.
    pub fn reload_ballast(&self) {
        let Ok(_all_there) = self.ballast.try_lock() else { return };
        if let Err(error) = self.load_ballast() {
            tracing::warn!(%error, "no room is kept for deletions");
        }
    }

    /// Does what must be possible on a disk without a byte left, where the database cannot even write that something goes: if
    /// `is_full` says that it failed for that, the ballast makes room and it is done once more. [`Store::reload_ballast`] is for when there is room again.
    pub async fn despite_full_disk<T, E, F>(&self, is_full: fn(&E) -> bool, attempt: impl Fn() -> F) -> Result<T, E>
    where
        F: Future<Output = Result<T, E>>,
    {
        match attempt().await {
            Err(full) if is_full(&full) => {
                tracing::warn!("the disk is full: what is kept for deletions is given up");
                let _given_up = self.ballast.lock().await;
                if let Err(error) = self.drop_ballast() {
                    tracing::warn!(%error, "there is nothing to give up");
                    return Err(full);
                }
                attempt().await
            }
            other => other,
        }
    }

    /// Makes a little room on a full disk.
    fn drop_ballast(&self) -> io::Result<()> {
        match OpenOptions::new().write(true).open(self.ballast_file()) {
            Ok(file) => file.set_len(0),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
            Err(error) => Err(error),
        }
    }

    fn ballast_file(&self) -> std::path::PathBuf {
        self.root.join("ballast")
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;

    #[tokio::test]
    async fn the_ballast_is_given_up_once_for_what_fails_on_a_full_disk_and_comes_back() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        store.load_ballast().unwrap();
        let there = || store.ballast_file().metadata().unwrap().len();
        assert_eq!(there(), BALLAST_BYTES);
        let attempts = AtomicUsize::new(0);
        let is_full = |error: &&str| *error == "full";
        let fails_with = |error, times| {
            attempts.store(0, Ordering::Relaxed);
            let (store, attempts) = (&store, &attempts);
            store.despite_full_disk(is_full, move || async move {
                // Not from under what is done on the room it makes.
                store.reload_ballast();
                let attempt = attempts.fetch_add(1, Ordering::Relaxed);
                if attempt < times { Err(error) } else { Ok(store.ballast_file().metadata().unwrap().len()) }
            })
        };
        assert_eq!(fails_with("full", 0).await, Ok(BALLAST_BYTES));
        assert_eq!(fails_with("broken", 2).await, Err("broken"));
        assert_eq!((attempts.load(Ordering::Relaxed), there()), (1, BALLAST_BYTES));
        assert_eq!(fails_with("full", 1).await, Ok(0));
        store.reload_ballast();
        assert_eq!(there(), BALLAST_BYTES);
        assert_eq!(fails_with("full", 2).await, Err("full"));
        assert_eq!((attempts.load(Ordering::Relaxed), there()), (2, 0));
    }
}
