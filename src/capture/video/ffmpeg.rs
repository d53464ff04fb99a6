//! What the FFmpeg of this machine can do.

use std::io::Read;
use std::path::Path;
use std::sync::OnceLock;
use std::time::Instant;

use crate::capture::CaptureError;
use crate::capture::child::{Outcome, Tool};
use crate::capture::hdr;
use crate::capture::limits::PROBE_TIME;

/// How this FFmpeg is told to keep every frame: `-fps_mode` from 5.1 on, `-vsync` before.
pub(super) fn passthrough_option() -> Result<&'static str, CaptureError> {
    static OPTION: OnceLock<&'static str> = OnceLock::new();
    if let Some(option) = OPTION.get() {
        return Ok(option);
    }
    let text = ask(&["-version"])?;
    Ok(OPTION.get_or_init(|| if is_before_5_1(&text) { "-vsync" } else { "-fps_mode" }))
}

/// Whether this FFmpeg has the filters that map HDR to sRGB.
pub(super) fn maps_hdr() -> Result<bool, CaptureError> {
    static MAPS: OnceLock<bool> = OnceLock::new();
    if let Some(&maps) = MAPS.get() {
        return Ok(maps);
    }
    let maps = knows("-filters", &hdr::FILTERS)?;
    Ok(*MAPS.get_or_init(|| maps))
}

/// Whether all `names` are in a list that FFmpeg prints.
pub(super) fn knows(list: &str, names: &[&str]) -> Result<bool, CaptureError> {
    let text = ask(&["-hide_banner", list])?;
    let known: Vec<&str> = text.lines().filter_map(|line| line.split_whitespace().nth(1)).collect();
    Ok(names.iter().all(|name| known.contains(name)))
}

/// What FFmpeg says of itself. An answer that did not come, on a machine that had no time or memory for it, says nothing.
fn ask(arguments: &[&str]) -> Result<String, CaptureError> {
    let (text, outcome) = run("ffmpeg", arguments, None, 1 << 20)?;
    if !outcome.success {
        let failed = std::io::Error::other(format!("`ffmpeg {}`{}", arguments.join(" "), outcome.because()));
        return Err(CaptureError::internal("what this FFmpeg can do", failed));
    }
    Ok(String::from_utf8_lossy(&text).into_owned())
}

/// Builds without a version number (`N-109000-g…`) are taken as recent.
fn is_before_5_1(version_text: &str) -> bool {
    let Some(version) = version_text.strip_prefix("ffmpeg version ") else { return false };
    let mut numbers = version.split(|c: char| !c.is_ascii_digit()).map(str::parse::<u32>);
    match (numbers.next(), numbers.next()) {
        (Some(Ok(major)), Some(Ok(minor))) => (major, minor) < (5, 1),
        _ => false,
    }
}

/// Runs a tool that answers quickly; its output, at most `limit` bytes of it.
pub(super) fn run(
    name: &'static str,
    arguments: &[&str],
    input: Option<&Path>,
    limit: u64,
) -> Result<(Vec<u8>, Outcome), CaptureError> {
    let (tool, mut output) = Tool::start(name, arguments, input, Instant::now() + PROBE_TIME)?;
    let mut bytes = Vec::new();
    // A broken pipe shows as a failed process.
    let _ = output.by_ref().take(limit).read_to_end(&mut bytes);
    Ok((bytes, tool.finish(output)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_are_told_apart() {
        assert!(is_before_5_1("ffmpeg version 4.4.2-0ubuntu0.22.04.1 Copyright"));
        assert!(!is_before_5_1("ffmpeg version 5.1.9-0+deb12u1 Copyright"));
        assert!(!is_before_5_1("ffmpeg version 7.1 Copyright"));
        assert!(!is_before_5_1("ffmpeg version N-109000-g3f1e Copyright"));
    }
}
