//! What a command says in the end.

use std::path::Path;

use anyhow::{Context, Result};
use serde::Deserialize;

/// Of `report.json`.
#[derive(Deserialize)]
pub(super) struct Report {
    metrics: Metrics,
    quality: Quality,
    warnings: Vec<String>,
}

#[derive(Deserialize)]
struct Metrics {
    frames: u32,
    /// None where no frame could be scored.
    mask_iou: Option<f64>,
    psnr: Option<f64>,
    secs: f64,
}

#[derive(Deserialize)]
struct Quality {
    flags: Vec<Flag>,
}

#[derive(Deserialize)]
struct Flag {
    code: String,
    message: String,
    advice: String,
}

impl Report {
    pub fn read(out: &Path) -> Result<Self> {
        let path = out.join("report.json");
        let text = std::fs::read(&path).with_context(|| path.display().to_string())?;
        serde_json::from_slice(&text).with_context(|| path.display().to_string())
    }

    /// The codes of the flags.
    pub fn codes(&self) -> Vec<&str> {
        self.quality.flags.iter().map(|flag| flag.code.as_str()).collect()
    }

    /// Where the avatar is, how well its own frames are met, and what to film better.
    pub fn text(&self, out: &Path) -> String {
        let Metrics { frames, mask_iou, psnr, secs } = self.metrics;
        let (avatar, page) = (out.join("avatar.glb"), out.join("report.html"));
        let mut text = format!("{}\n{}\n{frames} frames in {secs:.0} s", avatar.display(), page.display());
        if let (Some(iou), Some(psnr)) = (mask_iou, psnr) {
            text += &format!(", met with a mask IoU of {iou:.3} and {psnr:.1} dB");
        }
        text.push('\n');
        for Flag { code, message, advice } in &self.quality.flags {
            text += &format!("{code}: {message}. {advice}\n");
        }
        for warning in &self.warnings {
            text += &format!("{warning}\n");
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_end_names_the_files_the_fit_and_what_to_film_better() {
        let folder = tempfile::tempdir().unwrap();
        let report = serde_json::json!({
            "metrics": { "frames": 40, "mask_iou": 0.98, "psnr": 30.0, "secs": 61.2 },
            "quality": { "flags": [{ "code": "few_frames", "message": "8 frames", "advice": "Film longer." }] },
            "warnings": ["masks: maps of labels"],
        });
        std::fs::write(folder.path().join("report.json"), report.to_string()).unwrap();
        let report = Report::read(folder.path()).unwrap();
        let text = report.text(Path::new("out"));
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(
            lines,
            [
                "out/avatar.glb",
                "out/report.html",
                "40 frames in 61 s, met with a mask IoU of 0.980 and 30.0 dB",
                "few_frames: 8 frames. Film longer.",
                "masks: maps of labels",
            ]
        );
        assert_eq!(report.codes(), ["few_frames"]);
    }
}
