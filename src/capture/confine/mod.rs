//! What a decoder may do besides computing. Its input comes from strangers and its parsers are large: whoever takes it over
//! through a crafted file shall find neither files nor hosts nor other processes.
//!
//! Two fences of Linux, each where the kernel has it: Landlock for files (only the input, the program and the system's
//! libraries can be read, nothing can be written or executed besides), seccomp for system calls (no sockets, no processes,
//! no files opened for writing, nothing that looks into others). Memory, output and time are bounded beside this
//! ([`super::child`]).

#[cfg(target_os = "linux")]
mod calls;
#[cfg(target_os = "linux")]
mod fences;
#[cfg(all(test, target_os = "linux"))]
mod tests;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;
use std::time::{Duration, Instant};

use super::child::Tool;

/// Which fences stand around a decoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Confinement {
    /// Landlock: files.
    pub files: bool,
    /// seccomp: system calls.
    pub calls: bool,
}

impl Confinement {
    const NONE: Confinement = Confinement { files: false, calls: false };

    /// The strongest confinement in which FFmpeg still runs here: an installation may keep its libraries where nobody
    /// looks for them, and a kernel may lack a fence. Found out once.
    pub fn in_force() -> Confinement {
        static FOUND: OnceLock<Confinement> = OnceLock::new();
        *FOUND.get_or_init(|| {
            let whole = fences::available();
            let candidates = [whole, Confinement { files: false, ..whole }, Confinement::NONE];
            // Where it does not run without a fence either, the fences are not what keeps it from running. Nor are they where it
            // takes long.
            let found = candidates.into_iter().find_map(|confinement| match confinement.lets_ffmpeg_run() {
                Some(runs) => runs.then_some(confinement),
                None => Some(whole),
            });
            let found = found.unwrap_or(whole);
            if !(found.files && found.calls) {
                tracing::warn!(
                    files = found.files,
                    calls = found.calls,
                    "decoders run less confined than they could be"
                );
            }
            found
        })
    }

    /// `None` where it did not end in time.
    fn lets_ffmpeg_run(self) -> Option<bool> {
        let deadline = Instant::now() + Duration::from_secs(10);
        let started = Tool::start_confined("ffmpeg", &["-version"], None, deadline, self);
        let Ok((tool, mut output)) = started else { return Some(false) };
        let _ = std::io::copy(&mut output, &mut std::io::sink());
        let Ok(outcome) = tool.finish(output) else { return Some(false) };
        (!outcome.timed_out).then_some(outcome.success)
    }

    /// Prepares the command's child, which may read the file `input`. What is done between fork and exec is made ready
    /// here: there, nothing may be allocated.
    pub(super) fn apply(self, command: &mut Command, program: &Path, input: Option<&Path>) -> std::io::Result<()> {
        fences::raise(self, command, program, input)
    }
}

/// The file that a program's name stands for in `PATH`.
pub(super) fn program(name: &str) -> Option<PathBuf> {
    let path = std::env::var_os("PATH")?;
    let file = format!("{name}{}", std::env::consts::EXE_SUFFIX);
    std::env::split_paths(&path).map(|folder| folder.join(&file)).find(|file| file.is_file())
}

#[cfg(not(target_os = "linux"))]
mod fences {
    use std::path::Path;
    use std::process::Command;

    use super::Confinement;

    pub(super) fn available() -> Confinement {
        Confinement::NONE
    }

    pub(super) fn raise(_: Confinement, _: &mut Command, _: &Path, _: Option<&Path>) -> std::io::Result<()> {
        Ok(())
    }
}
