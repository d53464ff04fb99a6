//! Files on their way to being results.

use std::fs::{self, File};
use std::io::{self, Read};
use std::path::Path;

use sha2::{Digest, Sha256};

use crate::atomic_file::sync_dir;
use crate::fingerprint::hex;

/// A result file, flushed to the disk.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Published {
    pub name: String,
    pub bytes: u64,
    /// Lower-case hex.
    pub sha256: String,
}

impl Published {
    /// Flushes and hashes all files of a results folder, sorted by name. Blocks for as long as reading them takes.
    pub fn seal(folder: &Path) -> io::Result<Vec<Published>> {
        let mut sealed = Vec::new();
        for entry in fs::read_dir(folder)? {
            let entry = entry?;
            let Ok(name) = entry.file_name().into_string() else { continue };
            // Temporary files of writers begin with a dot.
            if entry.file_type()?.is_file() && !name.starts_with('.') {
                sealed.push(seal_file(&entry.path(), name)?);
            }
        }
        sync_dir(folder)?;
        if let Some(parent) = folder.parent() {
            sync_dir(parent)?;
        }
        sealed.sort_by(|a, b| a.name.cmp(&b.name));
        Ok(sealed)
    }
}

fn seal_file(path: &Path, name: String) -> io::Result<Published> {
    let mut file = File::open(path)?;
    file.sync_all()?;
    let mut hash = Sha256::new();
    let mut buffer = vec![0; 1 << 16];
    let mut bytes = 0;
    loop {
        let n = file.read(&mut buffer)?;
        if n == 0 {
            break;
        }
        hash.update(&buffer[..n]);
        bytes += n as u64;
    }
    Ok(Published { name, bytes, sha256: hex(&hash.finalize()) })
}
