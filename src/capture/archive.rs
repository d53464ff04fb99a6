//! A zip of images or JSON files: its entries in natural order, with limits on count, size and expansion.

use std::cmp::Ordering;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

use zip::ZipArchive;
use zip::read::ZipFile;
use zip::result::ZipError;

use super::limits::{ZIP_ENTRIES, ZIP_RATIO, ZIP_TOTAL_BYTES};
use super::{BadInput, CaptureError, Part};

pub(super) struct Archive {
    part: Part,
    archive: ZipArchive<BufReader<File>>,
    /// Name and place in the archive, in natural order.
    entries: Vec<(String, usize)>,
    /// Files with other endings, hidden ones not counted.
    pub ignored: usize,
}

/// Whether the file begins as a zip does. Uploads come without names that could be trusted.
pub(super) fn is_zip(path: &Path) -> Result<bool, CaptureError> {
    let mut head = Vec::new();
    let file = File::open(path).map_err(|e| CaptureError::internal("cannot open the upload", e))?;
    file.take(4).read_to_end(&mut head).map_err(|e| CaptureError::internal("cannot read the upload", e))?;
    Ok(head == b"PK\x03\x04" || head == b"PK\x05\x06")
}

impl Archive {
    /// The entries whose names end in one of `endings` (lower case, with the dot). At least one.
    pub fn open(part: Part, path: &Path, endings: &[&str]) -> Result<Self, CaptureError> {
        let file = File::open(path).map_err(|e| CaptureError::internal("cannot open the upload", e))?;
        if count_headers(&file).map_err(|e| CaptureError::internal("cannot read the upload", e))? > ZIP_ENTRIES {
            return Err(too_many_entries(part).into());
        }
        let damaged = |e: ZipError| BadInput::new(part, format!("the zip cannot be read: {e}"), "a whole zip archive");
        let mut archive = ZipArchive::new(BufReader::new(file)).map_err(damaged)?;
        if archive.len() > ZIP_ENTRIES {
            return Err(too_many_entries(part).into());
        }
        let (mut entries, mut ignored, mut total, mut other) = (Vec::new(), 0, 0u64, None);
        for index in 0..archive.len() {
            let entry = archive.by_index_raw(index).map_err(damaged)?;
            let name = entry.name().map_err(damaged)?.into_owned();
            check_name(part, &name)?;
            if entry.is_dir() || is_hidden(&name) {
                continue;
            }
            total = total.saturating_add(entry.size());
            check_size(part, &name, &entry, total)?;
            let lower = name.to_lowercase();
            if endings.iter().any(|ending| lower.ends_with(ending)) {
                entries.push((name, index));
            } else {
                ignored += 1;
                other.get_or_insert(name);
            }
        }
        if entries.is_empty() {
            let found = other.map_or("it is empty".to_owned(), |name| format!("it has `{}`", printable(&name)));
            let message = format!("no file in the zip can be used; {found}");
            return Err(BadInput::new(part, message, format!("files that end in {}", endings.join(", "))).into());
        }
        entries.sort_by(|a, b| natural_order(&a.0, &b.0));
        Ok(Self { part, archive, entries, ignored })
    }

    pub fn len(&self) -> usize {
        self.entries.len()
    }

    pub fn name(&self, index: usize) -> String {
        printable(&self.entries[index].0)
    }

    /// The first number that the entries' names leave out, where they are numbered one by one.
    pub fn gap(&self) -> Option<u64> {
        let numbers = self.entries.iter().map(|(name, _)| number_of(name)).collect::<Option<Vec<u64>>>()?;
        let jumps = numbers.array_windows().filter(|[a, b]| b.checked_sub(*a) != Some(1));
        let jumps: Vec<&[u64; 2]> = jumps.collect();
        // Names of which many jump are numbered otherwise.
        let few = 4 * jumps.len() < numbers.len();
        jumps.first().filter(|[a, b]| few && a < b).map(|[a, _]| a + 1)
    }

    /// The contents of an entry, at most `limit` bytes.
    pub fn read(&mut self, index: usize, limit: u64) -> Result<Vec<u8>, BadInput> {
        let (part, name) = (self.part, self.name(index));
        let mut bytes = Vec::new();
        let result = match self.archive.by_index(self.entries[index].1) {
            Ok(reader) => reader.take(limit + 1).read_to_end(&mut bytes).map_err(|e| e.to_string()),
            Err(e) => Err(e.to_string()),
        };
        if let Err(reason) = result {
            return Err(BadInput::new(part, format!("`{name}` cannot be read: {reason}"), "a whole file").at(index));
        }
        if bytes.len() as u64 > limit {
            let message = format!("`{name}` is larger than {limit} bytes");
            return Err(BadInput::new(part, message, format!("at most {limit} bytes a file")).at(index));
        }
        Ok(bytes)
    }
}

/// The last number in a file's name, without what follows it: `clip_000012_keypoints.json` is 12.
fn number_of(name: &str) -> Option<u64> {
    let file = name.rsplit(['/', '\\']).next().unwrap_or(name);
    let digits = |c: char| c.is_ascii_digit();
    let end = file.rfind(digits)? + 1;
    let start = file[..end].rfind(|c| !digits(c)).map_or(0, |i| i + file[i..].chars().next().map_or(1, char::len_utf8));
    file[start..end].parse().ok()
}

fn too_many_entries(part: Part) -> BadInput {
    BadInput::new(part, "the zip has too many entries", format!("at most {ZIP_ENTRIES}"))
}

/// Number of central directory headers in a zip, an upper bound of its entries. Opening an archive keeps every entry
/// in memory, so that a large file made of headers alone must be refused before.
fn count_headers(file: &File) -> std::io::Result<usize> {
    const SMALLEST_HEADER: u64 = 46;
    let bytes = file.metadata()?.len();
    if bytes / SMALLEST_HEADER <= ZIP_ENTRIES as u64 {
        return Ok(0);
    }
    let (mut reader, mut count, mut last_four) = (file, 0, 0u32);
    let mut block = vec![0; 1 << 16];
    loop {
        let n = reader.read(&mut block)?;
        if n == 0 {
            return Ok(count);
        }
        for &byte in &block[..n] {
            last_four = last_four << 8 | u32::from(byte);
            count += usize::from(last_four == u32::from_be_bytes(*b"PK\x01\x02"));
        }
    }
}

/// Nothing is ever written under an entry's name; a name that leaves the archive still means that it is hostile.
fn check_name(part: Part, name: &str) -> Result<(), BadInput> {
    let leaves = name.split(['/', '\\']).any(|piece| piece == "..");
    let absolute = name.starts_with(['/', '\\']) || name.get(1..2) == Some(":");
    if leaves || absolute || name.contains('\0') {
        let message = format!("the zip has an entry named `{}`", printable(name));
        return Err(BadInput::new(part, message, "relative names without `..`"));
    }
    Ok(())
}

fn check_size(part: Part, name: &str, entry: &ZipFile<'_, BufReader<File>>, total: u64) -> Result<(), BadInput> {
    let (packed, size) = (entry.compressed_size().max(1), entry.size());
    if size > 1 << 20 && size / packed > ZIP_RATIO {
        let message = format!("`{}` expands from {packed} to {size} bytes", printable(name));
        return Err(BadInput::new(part, message, format!("an expansion of at most {ZIP_RATIO} times")));
    }
    if total > ZIP_TOTAL_BYTES {
        let message = format!("the zip expands to more than {ZIP_TOTAL_BYTES} bytes");
        return Err(BadInput::new(part, message, format!("at most {ZIP_TOTAL_BYTES} bytes")));
    }
    Ok(())
}

fn is_hidden(name: &str) -> bool {
    // Names of `tar`'s zips begin with `./`.
    name.split('/').any(|piece| piece.starts_with('.') && piece != "." || piece == "__MACOSX")
}

/// A name as it may stand in a message.
fn printable(name: &str) -> String {
    name.chars().filter(|c| !c.is_control()).take(80).collect()
}

/// Order of names in which runs of digits count as numbers: `frame9` before `frame10`.
fn natural_order(a: &str, b: &str) -> Ordering {
    let (mut a, mut b) = (a.as_bytes(), b.as_bytes());
    while let (Some(x), Some(y)) = (a.first(), b.first()) {
        if x.is_ascii_digit() && y.is_ascii_digit() {
            let (number_a, number_b) = (take_number(&mut a), take_number(&mut b));
            match number_a.len().cmp(&number_b.len()).then(number_a.cmp(number_b)) {
                Ordering::Equal => continue,
                order => return order,
            }
        }
        match x.cmp(y) {
            Ordering::Equal => (a, b) = (&a[1..], &b[1..]),
            order => return order,
        }
    }
    a.len().cmp(&b.len())
}

/// Takes the leading digits off `text`; without their leading zeros.
fn take_number<'a>(text: &mut &'a [u8]) -> &'a [u8] {
    let end = text.iter().position(|c| !c.is_ascii_digit()).unwrap_or(text.len());
    let (digits, rest) = text.split_at(end);
    *text = rest;
    &digits[digits.iter().position(|&c| c != b'0').unwrap_or(end)..]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_sort_as_people_count() {
        let mut names = ["m/10.png", "m/9.png", "m/0011.png", "m/1.png", "a/100.png", "m/x.png"];
        names.sort_by(|a, b| natural_order(a, b));
        assert_eq!(names, ["a/100.png", "m/1.png", "m/9.png", "m/10.png", "m/0011.png", "m/x.png"]);
    }

    #[test]
    fn names_that_leave_the_archive_are_refused() {
        for name in ["../a.png", "a/../../b.png", "/etc/a.png", "..\\a.png", "C:/a.png", "a\0.png"] {
            assert!(check_name(Part::Masks, name).is_err(), "{name:?}");
        }
        for name in ["a..b.png", "masks/0.png", "é/0.png"] {
            assert!(check_name(Part::Masks, name).is_ok(), "{name:?}");
        }
    }

    #[test]
    fn hidden_files_are_known() {
        assert!(is_hidden("__MACOSX/a/._0.png") && is_hidden(".DS_Store"));
        assert!(!is_hidden("a/0.png") && !is_hidden("./0.png") && is_hidden("./._0.png"));
    }
}
