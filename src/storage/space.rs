//! Room on the disk: a reserve that new work must leave free, and ballast that makes room for a deletion when there is
//! none at all.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};

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
        let there = self.ballast().metadata().map_or(0, |meta| meta.len());
        // It is what the reserve is for: a deletion takes little of it, and frees what it can be filled from.
        let bytes = BALLAST_BYTES.min(there.saturating_add(self.free_bytes()?));
        if there >= bytes {
            return Ok(());
        }
        let mut file = File::create(self.ballast())?;
        file.write_all(&vec![0x5a; bytes as usize])?;
        file.sync_all()
    }

    /// Makes a little room on a full disk.
    pub fn drop_ballast(&self) -> io::Result<()> {
        match OpenOptions::new().write(true).open(self.ballast()) {
            Ok(file) => file.set_len(0),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
            Err(error) => Err(error),
        }
    }

    fn ballast(&self) -> std::path::PathBuf {
        self.root.join("ballast")
    }
}
