//! What a checkpoint was made by. It holds what is fitted, and nothing of what that stands on: the body, its toes and ears, the focal
//! length and the kept frames are found anew by each attempt. Another program may find others.

use std::io;
use std::path::{Path, PathBuf};

use crate::fingerprint::Fingerprint;
use crate::jobs::JobOptions;

const MARK: &str = "made-by";

/// Leaves checkpoints and losses in `work_dir` to go on from only where this very program has written them, with this body and these
/// options; otherwise there are none, and the fit begins anew.
pub(super) fn begin_anew_for_others(work_dir: &Path, body_file: &Path, options: &JobOptions) -> io::Result<()> {
    let options = serde_json::to_string(options).map_err(io::Error::other)?;
    let mut made_by = Fingerprint::of_program()?.with_text(&options);
    // The built-in body is the program's.
    if body_file.is_file() {
        made_by = made_by.with_file(body_file)?;
    }
    let (made_by, mark) = (made_by.digits(), work_dir.join(MARK));
    if std::fs::read_to_string(&mark).is_ok_and(|mark| mark == made_by) {
        return Ok(());
    }
    std::fs::create_dir_all(work_dir)?;
    let mut kept = 0;
    // The mark goes first: what is half gone is nobody's.
    for path in std::iter::once(mark.clone()).chain(files(work_dir)?) {
        match std::fs::remove_file(&path) {
            Ok(()) => kept += usize::from(path != mark),
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(error),
        }
    }
    if kept > 0 {
        tracing::info!("the checkpoint is of another program, body or options: the fit begins anew");
    }
    crate::storage::write_atomic(&mark, made_by.as_bytes())
}

/// Checkpoints and losses.
fn files(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder)?.collect::<io::Result<Vec<_>>>()?;
    let is_kept = |path: &PathBuf| path.extension().is_some_and(|ending| ending == "npz" || ending == "json");
    Ok(entries.into_iter().map(|entry| entry.path()).filter(is_kept).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_this_program_made_with_this_body_and_these_options_is_gone_on_from() {
        let folder = tempfile::tempdir().unwrap();
        let (work, body) = (folder.path().join("work"), folder.path().join("body.npz"));
        std::fs::write(&body, "one").unwrap();
        let mut options = JobOptions::default();
        let goes_on = |options: &JobOptions| {
            begin_anew_for_others(&work, &body, options).unwrap();
            let goes_on = work.join("checkpoint.npz").exists();
            std::fs::write(work.join("checkpoint.npz"), "").unwrap();
            goes_on
        };
        assert!(!goes_on(&options) && goes_on(&options));
        options.seed = 7;
        assert!(!goes_on(&options) && goes_on(&options));
        std::fs::write(&body, "two").unwrap();
        assert!(!goes_on(&options) && goes_on(&options));
        // As another program leaves it, or one of before there were marks.
        std::fs::write(work.join(MARK), "0123456789abcdef").unwrap();
        assert!(!goes_on(&options) && goes_on(&options));
        std::fs::remove_file(work.join(MARK)).unwrap();
        assert!(!goes_on(&options) && goes_on(&options));
    }
}
