//! Files on their way out: whole or a range of them (RFC 9110, section 14).

use std::io;
use std::path::Path;

use tokio::fs::File;
use tokio::io::{AsyncReadExt, AsyncSeekExt, Take};

/// Bytes `start..end` of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ByteRange {
    pub start: u64,
    pub end: u64,
}

impl ByteRange {
    pub fn len(self) -> u64 {
        self.end - self.start
    }

    pub fn is_empty(self) -> bool {
        self.start == self.end
    }
}

/// Reads a `Range` header for a file of `size` bytes. `None`: send the whole file, because the header asks for another
/// unit or several ranges, or is malformed. `Some(Err)`: nothing of what it asks for exists.
pub fn parse_range(header: &str, size: u64) -> Option<Result<ByteRange, ()>> {
    let (unit, range) = header.split_once('=')?;
    let (first, last) = range.trim().split_once('-')?;
    if !unit.trim().eq_ignore_ascii_case("bytes") || range.contains(',') {
        return None;
    }
    let number = |text: &str| {
        let digits = !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
        // More digits than fit mean "to the end" or "beyond it".
        digits.then(|| text.parse::<u64>().unwrap_or(u64::MAX))
    };
    let (first, last) = (first.trim(), last.trim());
    if first.is_empty() {
        let suffix = number(last)?;
        return Some(if suffix == 0 || size == 0 {
            Err(())
        } else {
            Ok(ByteRange { start: size.saturating_sub(suffix), end: size })
        });
    }
    let start = number(first)?;
    let last = if last.is_empty() { u64::MAX } else { number(last)? };
    if last < start {
        return None;
    }
    Some(if start >= size { Err(()) } else { Ok(ByteRange { start, end: last.saturating_add(1).min(size) }) })
}

/// Opens a file at the start of a range; the reader ends with it.
pub async fn open_range(path: &Path, range: ByteRange) -> io::Result<Take<File>> {
    let mut file = File::open(path).await?;
    if range.start > 0 {
        file.seek(io::SeekFrom::Start(range.start)).await?;
    }
    Ok(file.take(range.len()))
}
