//! Made clips that are kept for the next run.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::{SynthError, SynthOptions, synthesise};
use crate::body::Body;
use crate::data_dir::body_path;
use crate::fingerprint::Fingerprint;
use crate::gpu::Gpu;

/// A folder of made clips of one body.
pub struct KeptClips<'a> {
    pub gpu: &'a Arc<Gpu>,
    /// A body of the data folder, or `test` for the small built-in one.
    pub body: &'a str,
    pub folder: &'a Path,
}

impl KeptClips<'_> {
    /// The body.
    ///
    /// # Errors
    /// Where the data folder has none of that name, or what it has is no body.
    pub fn load_body(&self) -> Result<Body, SynthError> {
        if self.body == "test" {
            return Ok(Body::test_body());
        }
        let path = body_path(self.body);
        Body::load(&path).map_err(|source| SynthError::Body { path, source })
    }

    /// The folder of a clip ([`synthesise`]). One that is there is taken if this program made it, with these options and of the
    /// same body; its name tells.
    ///
    /// # Errors
    /// As [`synthesise`], and where the folder cannot be written.
    pub fn clip(&self, options: &SynthOptions) -> Result<PathBuf, SynthError> {
        let options_text = serde_json::to_string(options)?;
        let made_of = Fingerprint::of_program()?.with_text(&options_text).with_body(self.body)?;
        let SynthOptions { frames, size_px, .. } = options;
        let name = format!("clip-{}-{frames}x{size_px}-{}", self.body, made_of.digits());
        let clip = self.folder.join(&name);
        if clip.is_dir() {
            return Ok(clip);
        }
        std::fs::create_dir_all(self.folder)?;
        // Under another name until it is whole.
        let making = tempfile::tempdir_in(self.folder)?;
        let part = making.path().join(name);
        synthesise(self.gpu, &self.load_body()?, options, &part, |_, _| {})?;
        match std::fs::rename(&part, &clip) {
            // Another run has made the same meanwhile.
            Err(_) if clip.is_dir() => Ok(clip),
            renamed => Ok(renamed.map(|()| clip)?),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ops::testing::gpu;

    #[test]
    fn a_clip_is_made_once_for_each_choice_of_options() {
        let Some(gpu) = gpu("synth::a_clip_is_made_once_for_each_choice_of_options") else { return };
        let folder = tempfile::tempdir().unwrap();
        let clips = KeptClips { gpu: &gpu, body: "test", folder: folder.path() };
        let options = SynthOptions { frames: 2, size_px: 64, truths: 1, ..SynthOptions::default() };
        // Two that want it at once get the same.
        let [clip, same] = std::thread::scope(|scope| {
            [scope.spawn(|| clips.clip(&options)), scope.spawn(|| clips.clip(&options))]
                .map(|made| made.join().unwrap().unwrap())
        });
        assert_eq!(clip, same);
        assert!(clip.join("video.mp4").is_file() && clip.join("keypoints.json").is_file());
        let mark = clip.join("mark");
        std::fs::write(&mark, "").unwrap();
        assert_eq!(clips.clip(&options).unwrap(), clip);
        assert!(mark.exists(), "the clip was made anew");
        let mut other = options;
        other.filming.tilt_degrees = 10.0;
        assert_ne!(clips.clip(&other).unwrap(), clip);
    }

    #[test]
    fn a_body_that_is_missing_is_named() {
        let Some(gpu) = gpu("synth::a_body_that_is_missing_is_named") else { return };
        let folder = tempfile::tempdir().unwrap();
        let clips = KeptClips { gpu: &gpu, body: "nobody", folder: folder.path() };
        for error in [clips.load_body().unwrap_err(), clips.clip(&SynthOptions::default()).unwrap_err()] {
            let error = error.to_string();
            assert!(error.contains("nobody") && error.contains("make body"), "{error}");
        }
    }
}
