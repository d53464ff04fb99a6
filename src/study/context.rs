//! What a study may use: device, body, seed, made clips, and the program itself for whole fits.

use std::path::PathBuf;
use std::process::Command;
use std::sync::Arc;

use anyhow::{Context as _, Result, ensure};

use crate::body::Body;
use crate::gpu::Gpu;
use crate::synth::{KeptClips, SynthOptions};

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
    fn clips(&self) -> KeptClips<'_> {
        KeptClips { gpu: &self.gpu, body: &self.body, folder: &self.work }
    }

    /// The study's body.
    pub fn load_body(&self) -> Result<Body> {
        Ok(self.clips().load_body()?)
    }

    /// The folder of a made clip of the study's body.
    pub fn clip(&self, options: &SynthOptions) -> Result<PathBuf> {
        (self.say)(&format!("a clip of {} frames of {}²", options.frames, options.size_px));
        Ok(self.clips().clip(options)?)
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
    fn a_program_that_cannot_run_is_named() {
        let Some(gpu) = gpu("study::a_program_that_cannot_run_is_named") else { return };
        let error = Context::for_test(gpu, std::path::Path::new(".")).run_effigy(&["fit"]).unwrap_err();
        assert!(error.to_string().contains("no such program"), "{error}");
    }
}
