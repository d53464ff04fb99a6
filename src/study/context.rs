//! What a study may use: device, body, seed, made clips, and the program itself for whole fits.

use std::path::PathBuf;
use std::process::Command;
use std::sync::Arc;

use anyhow::{Context as _, Result, ensure};

use crate::body::Body;
use crate::data_dir::body_path;
use crate::eval::{SynthOptions, synthesise};
use crate::gpu::Gpu;

/// The surroundings of a study.
pub struct Context<'a> {
    pub gpu: Arc<Gpu>,
    /// A body of the data folder, or `test` for the small built-in one.
    pub body: String,
    /// Decides everything random.
    pub seed: u64,
    /// Clips and avatars in between; they are kept for the next run.
    pub work: PathBuf,
    /// This program, for fits that are measured as processes of their own.
    pub effigy: PathBuf,
    /// Hears what is being done.
    pub say: &'a dyn Fn(&str),
}

impl Context<'_> {
    /// The study's body.
    pub fn load_body(&self) -> Result<Body> {
        if self.body == "test" {
            return Ok(Body::test_body());
        }
        let path = body_path(&self.body);
        Body::load(&path).with_context(|| format!("{}: import a body first (`make body`)", path.display()))
    }

    /// The folder of a made clip of the study's body ([`synthesise`]); one that is there is taken.
    pub fn clip(&self, options: &SynthOptions) -> Result<PathBuf> {
        let SynthOptions { frames, size_px, seed, truths, outfit, side_light, .. } = options;
        let outfit = format!("{outfit:?}").to_lowercase();
        let name = format!("clip-{}-{outfit}-{side_light}-{frames}x{size_px}-{truths}-{seed}", self.body);
        let folder = self.work.join(&name);
        if folder.is_dir() {
            return Ok(folder);
        }
        (self.say)(&format!("making a clip of {frames} frames of {size_px}²"));
        std::fs::create_dir_all(&self.work).with_context(|| self.work.display().to_string())?;
        // Under another name until it is whole.
        let making = tempfile::tempdir_in(&self.work)?;
        let part = making.path().join(name);
        synthesise(&self.gpu, &self.load_body()?, options, &part, |_, _| {})?;
        std::fs::rename(&part, &folder)?;
        Ok(folder)
    }

    /// Runs this program with `arguments` and waits; an error carries what it wrote last.
    pub fn run_effigy(&self, arguments: &[&str]) -> Result<()> {
        let output = Command::new(&self.effigy)
            .args(arguments)
            .output()
            .with_context(|| format!("{}: cannot be started", self.effigy.display()))?;
        let said = String::from_utf8_lossy(&output.stderr);
        let last = said.lines().rev().take(5).collect::<Vec<_>>().into_iter().rev().collect::<Vec<_>>().join("\n");
        ensure!(output.status.success(), "effigy {}: {}: {last}", arguments.join(" "), output.status);
        Ok(())
    }

    /// An empty folder `name` in the work folder.
    pub fn fresh_folder(&self, name: &str) -> Result<PathBuf> {
        let folder = self.work.join(name);
        if folder.exists() {
            std::fs::remove_dir_all(&folder).with_context(|| folder.display().to_string())?;
        }
        std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
        Ok(folder)
    }
}

#[cfg(test)]
impl Context<'_> {
    /// The surroundings of a test: the test body, a silent listener.
    pub(super) fn for_test(gpu: Arc<Gpu>, work: &std::path::Path) -> Context<'static> {
        let effigy = PathBuf::from("no such program");
        Context { gpu, body: "test".to_owned(), seed: 1, work: work.to_owned(), effigy, say: &|_| {} }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ops::testing::gpu;

    #[test]
    fn a_clip_is_made_once() {
        let Some(gpu) = gpu("study::a_clip_is_made_once") else { return };
        let work = tempfile::tempdir().unwrap();
        let context = Context::for_test(gpu, work.path());
        let options = SynthOptions { frames: 2, size_px: 64, truths: 1, ..SynthOptions::default() };
        let folder = context.clip(&options).unwrap();
        assert!(folder.join("video.mp4").is_file() && folder.join("keypoints.json").is_file());
        let mark = folder.join("mark");
        std::fs::write(&mark, "").unwrap();
        assert_eq!(context.clip(&options).unwrap(), folder);
        assert!(mark.exists(), "the clip was made anew");
        let other = context.clip(&SynthOptions { seed: 2, ..options }).unwrap();
        assert_ne!(other, folder);
    }

    #[test]
    fn a_program_that_cannot_run_is_named() {
        let Some(gpu) = gpu("study::a_program_that_cannot_run_is_named") else { return };
        let error = Context::for_test(gpu, std::path::Path::new(".")).run_effigy(&["fit"]).unwrap_err();
        assert!(error.to_string().contains("no such program"), "{error}");
    }
}
