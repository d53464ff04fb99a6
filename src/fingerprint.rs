//! What something kept was made of: a digest over the program, texts and files, so that what was made of others is made anew.

use std::io::{self, Read};
use std::path::Path;
use std::sync::OnceLock;

use sha2::{Digest, Sha256};

use crate::data_dir::body_path;

/// A digest that grows. Two are equal where the same things were added in the same order.
#[derive(Clone, Debug)]
pub struct Fingerprint(Sha256);

impl Fingerprint {
    /// Begins with this program's own file: another build may make something else of the same options.
    ///
    /// # Errors
    /// Where the program's file cannot be read.
    pub fn of_program() -> io::Result<Self> {
        static PROGRAM: OnceLock<[u8; 32]> = OnceLock::new();
        let digest = match PROGRAM.get() {
            Some(digest) => *digest,
            None => {
                let mut hash = Sha256::new();
                add(&mut hash, &mut running_program()?)?;
                *PROGRAM.get_or_init(|| hash.finalize().into())
            }
        };
        Ok(Self(Sha256::new_with_prefix(digest)))
    }

    #[must_use]
    pub fn with_text(mut self, text: &str) -> Self {
        self.0.update((text.len() as u64).to_le_bytes());
        self.0.update(text);
        self
    }

    /// # Errors
    /// Where the file cannot be read.
    pub fn with_file(mut self, path: &Path) -> io::Result<Self> {
        let mut file = std::fs::File::open(path)?;
        self.0.update(file.metadata()?.len().to_le_bytes());
        add(&mut self.0, &mut file)?;
        Ok(self)
    }

    /// A body of the data folder. The built-in one has no file: it is the program's.
    ///
    /// # Errors
    /// Where the body's file is there and cannot be read.
    pub fn with_body(self, name: &str) -> io::Result<Self> {
        let path = body_path(name);
        if path.is_file() { self.with_file(&path) } else { Ok(self) }
    }

    /// The names and contents of a folder's own files, not of folders in it.
    ///
    /// # Errors
    /// Where the folder or one of its files cannot be read.
    pub fn with_files_of(mut self, folder: &Path) -> io::Result<Self> {
        let mut files: Vec<_> = std::fs::read_dir(folder)?.collect::<io::Result<_>>()?;
        files.sort_by_key(std::fs::DirEntry::file_name);
        for entry in files.iter().filter(|entry| entry.path().is_file()) {
            self = self.with_text(&entry.file_name().to_string_lossy()).with_file(&entry.path())?;
        }
        Ok(self)
    }

    /// Sixteen hexadecimal digits.
    #[must_use]
    pub fn digits(self) -> String {
        hex(&self.0.finalize()[..8])
    }
}

/// Lower-case hexadecimal digits, as digests are written everywhere.
#[must_use]
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The file that runs, also where another has taken its place since.
fn running_program() -> io::Result<std::fs::File> {
    #[cfg(target_os = "linux")]
    if let Ok(file) = std::fs::File::open("/proc/self/exe") {
        return Ok(file);
    }
    std::fs::File::open(std::env::current_exe()?)
}

fn add(hash: &mut Sha256, source: &mut impl Read) -> io::Result<()> {
    let mut piece = vec![0; 1 << 20];
    loop {
        match source.read(&mut piece)? {
            0 => return Ok(()),
            n => hash.update(&piece[..n]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_tells_texts_files_and_their_names_apart() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        std::fs::write(&path, "one").unwrap();
        let start = || Fingerprint::of_program().unwrap();
        let of_folder = || start().with_files_of(folder.path()).unwrap().digits();
        let all = [
            start().digits(),
            start().with_text("ab").with_text("c").digits(),
            start().with_text("a").with_text("bc").digits(),
            of_folder(),
            {
                std::fs::write(&path, "two").unwrap();
                of_folder()
            },
            {
                std::fs::rename(&path, folder.path().join("b")).unwrap();
                of_folder()
            },
        ];
        assert_eq!(all.iter().collect::<std::collections::BTreeSet<_>>().len(), all.len(), "{all:?}");
        assert_eq!(of_folder(), of_folder());
        assert_eq!(all[0].len(), 16);
    }

    #[test]
    fn a_file_that_is_not_there_is_an_error() {
        let missing = Fingerprint::of_program().unwrap().with_file(Path::new("no such file"));
        assert_eq!(missing.unwrap_err().kind(), io::ErrorKind::NotFound);
    }
}
