//! What a checkpoint was made by. It holds what is fitted, and nothing of what that stands on: the body, its toes and ears, the focal
//! length and the kept frames are found anew by each attempt. Another program may find others.

use std::io;
use std::path::{Path, PathBuf};

use super::PipelineInput;
use crate::capture::CaptureInputs;
use crate::fingerprint::Fingerprint;

const MARK: &str = "made-by";

/// Leaves checkpoints and losses in `work_dir` to go on from only where this very program has written them, of these files with these
/// options and this body; otherwise there are none, and the fit begins anew. Says whether something was thrown away.
pub(super) fn begin_anew_for_others(work_dir: &Path, input: &PipelineInput, body_file: &Path) -> io::Result<bool> {
    let options = serde_json::to_string(&input.options).map_err(io::Error::other)?;
    let mut made_by = Fingerprint::of_program()?.with_text(&options);
    let CaptureInputs { video, masks, keypoints, camera, poses } = input.files.clone();
    let parts = [("video", Some(video)), ("masks", Some(masks)), ("keypoints", Some(keypoints))];
    let parts = parts.into_iter().chain([("camera", camera), ("poses", poses), ("body", Some(body_file.into()))]);
    for (name, file) in parts {
        // The built-in body has none, and what else is missing is found out by whoever reads it.
        if let Some(file) = file.filter(|file| file.is_file()) {
            made_by = made_by.with_text(name).with_file(&file)?;
        }
    }
    let (made_by, mark) = (made_by.digits(), work_dir.join(MARK));
    if std::fs::read_to_string(&mark).is_ok_and(|mark| mark == made_by) {
        return Ok(false);
    }
    std::fs::create_dir_all(work_dir)?;
    let mut thrown_away = false;
    // The mark goes first: what is half gone is nobody's.
    for path in std::iter::once(mark.clone()).chain(files(work_dir)?) {
        match std::fs::remove_file(&path) {
            Ok(()) => thrown_away |= path != mark,
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(error),
        }
    }
    crate::atomic_file::write(&mark, made_by.as_bytes())?;
    Ok(thrown_away)
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
    use crate::jobs::JobOptions;

    #[test]
    fn only_what_this_program_made_of_these_files_with_these_options_and_this_body_is_gone_on_from() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str| folder.path().join(name);
        ["video", "masks", "keypoints", "body"].iter().for_each(|name| std::fs::write(file(name), name).unwrap());
        let files = CaptureInputs {
            video: file("video"),
            masks: file("masks"),
            keypoints: file("keypoints"),
            camera: None,
            poses: None,
        };
        let mut input = PipelineInput { files, options: JobOptions::default() };
        let (work, checkpoint) = (file("work"), file("work").join("checkpoint.npz"));
        // As an older version left it.
        std::fs::create_dir(&work).unwrap();
        std::fs::write(&checkpoint, "").unwrap();
        let begins_anew = |input: &PipelineInput| {
            let thrown_away = begin_anew_for_others(&work, input, &file("body")).unwrap();
            assert_eq!(thrown_away, !checkpoint.exists());
            std::fs::write(&checkpoint, "").unwrap();
            thrown_away
        };
        assert!(begins_anew(&input) && !begins_anew(&input));
        input.options.height_m = Some(1.7);
        assert!(begins_anew(&input) && !begins_anew(&input));
        std::fs::write(file("masks"), "MASKS").unwrap();
        assert!(begins_anew(&input) && !begins_anew(&input));
        input.files.camera = Some(file("keypoints"));
        assert!(begins_anew(&input) && !begins_anew(&input));
        (input.files.camera, input.files.poses) = (None, input.files.camera);
        assert!(begins_anew(&input) && !begins_anew(&input), "the same file as something else");
        std::fs::write(file("body"), "another").unwrap();
        assert!(begins_anew(&input) && !begins_anew(&input));
        // As another program leaves it, or one of before there were marks.
        std::fs::write(work.join(MARK), "0123456789abcdef").unwrap();
        assert!(begins_anew(&input) && !begins_anew(&input));
        std::fs::remove_file(work.join(MARK)).unwrap();
        assert!(begins_anew(&input) && !begins_anew(&input));
    }
}
