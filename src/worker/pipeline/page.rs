//! `report.html`: what came of a job, to be looked at.

use std::collections::{BTreeMap, BTreeSet};
use std::f32::consts::PI;

use glam::{Mat3, Quat, Vec3};
use image::{Rgb, RgbImage, RgbaImage};
use serde_json::Value;

use super::closeups::{Filmed, closeups};
use super::curves::Point;
use super::quality::Quality;
use super::score::{FrameScore, spec_of};
use super::{PipelineError, Stage};
use crate::avatar::{Place, Pose, RenderError, RenderSpec, Renderer};
use crate::body::N_POSE;
use crate::body::joints::{LEFT_SHOULDER, RIGHT_SHOULDER};
use crate::camera::Camera;
use crate::capture::{Capture, Frame};
use crate::mask::is_foreground;
use crate::page::{Curve, Page, chart, heat_map, inline_jpeg, over, shrunk, strip};
use crate::picture::Background;

/// Frames shown for being the worst, and frames spread over the clip.
const WORST: usize = 3;
const SPREAD: usize = 5;
/// Sides of the turntable, and the size of each.
const SIDES: usize = 10;
const SIDE_PX: (u32, u32) = (200, 310);
const BACKDROP: [u8; 3] = [236; 3];
/// Longest side of a frame's picture.
const FRAME_PX: u32 = 460;
/// Of the range 1: the lightest colour of the heat map.
const HEAT_MOST: f32 = 0.25;

/// The pictures of the page, as HTML, with captions.
pub(super) struct Pictures {
    turntable: String,
    frames: Vec<(String, String)>,
    closeups: Vec<(String, String)>,
}

/// Draws what the page shows. Waits.
pub(super) fn pictures(
    renderer: &Renderer,
    capture: &Capture,
    filmed: &Filmed<'_>,
    scores: &[FrameScore],
) -> Result<Pictures, PipelineError> {
    let turntable = turntable(renderer).map_err(anyhow::Error::from)?;
    let mut frames = Vec::new();
    for (place, k) in chosen(scores).into_iter().enumerate() {
        let (frame, score) = (&capture.frames[k], &scores[k]);
        let ours = renderer.render(&spec_of(renderer, k, frame)).map_err(anyhow::Error::from)?;
        let picture = shrunk(&comparison(frame, &ours), 3 * FRAME_PX);
        let rank = if place < WORST { ", among the worst" } else { "" };
        let caption = format!("frame {}: IoU {:.3}, PSNR {:.1} dB{rank}", score.frame, score.iou, score.psnr);
        frames.push((inline_jpeg(&picture, 82, "input, fit over it, difference"), caption));
    }
    Ok(Pictures { turntable, frames, closeups: closeups(renderer, filmed)? })
}

/// The worst frames first, then frames spread evenly, none twice.
fn chosen(scores: &[FrameScore]) -> Vec<usize> {
    let mut by_psnr: Vec<usize> = (0..scores.len()).collect();
    by_psnr.sort_by(|&a, &b| scores[a].psnr.total_cmp(&scores[b].psnr));
    let spread = (0..SPREAD).map(|i| i * scores.len() / SPREAD).filter(|&k| k < scores.len());
    let mut seen = BTreeSet::new();
    by_psnr.into_iter().take(WORST).chain(spread).filter(|&k| seen.insert(k)).collect()
}

/// The input, the fit over it, and how much they differ, each on white outside its own mask.
fn comparison(frame: &Frame, ours: &RgbaImage) -> RgbImage {
    let (width, height) = (frame.width, frame.height);
    let at = |x: u32, y: u32| (y * width + x) as usize;
    let input = RgbImage::from_fn(width, height, |x, y| Rgb(std::array::from_fn(|k| frame.rgb[3 * at(x, y) + k])));
    let white = RgbImage::from_pixel(width, height, Rgb([255; 3]));
    let on_white = over(ours, &white);
    let error = |x: u32, y: u32| {
        let theirs = if is_foreground(frame.mask[at(x, y)]) { input.get_pixel(x, y).0 } else { [255; 3] };
        let ours = on_white.get_pixel(x, y).0;
        (0..3).map(|k| f32::from(ours[k].abs_diff(theirs[k]))).sum::<f32>() / (3.0 * 255.0)
    };
    let errors: Vec<f32> =
        (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| error(x, y)).collect();
    strip(&[input.clone(), over(ours, &input), heat_map(&errors, width, height, HEAT_MOST)], 4, [255; 3])
}

fn turntable(renderer: &Renderer) -> Result<String, RenderError> {
    let (width, height) = SIDE_PX;
    let ys = renderer.model().rest_vertices().into_iter().map(|v| v[1]);
    let (low, high) = ys.fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), y| (l.min(y), h.max(y)));
    let pelvis = renderer.model().body.shaped_joints(&renderer.model().betas)[0][1];
    let focal = 1.4 * f64::from(height);
    // The person fills nine tenths of the height; y runs down.
    let distance = focal as f32 * (high - low) / (0.9 * height as f32);
    // The light stands in the clip's world, which its camera may see turned.
    let camera = Camera {
        rotation: renderer.model().camera.rotation,
        ..Camera::pinhole(width, height, [focal, focal, 0.5 * f64::from(width), 0.5 * f64::from(height)])
    };
    let to_world = Mat3::from_cols_array(&camera.rotation.map(|r| r as f32));
    let side = |i: usize| -> Result<RgbImage, RenderError> {
        let place = to_world * Vec3::new(0.0, 0.5 * (low + high) - pelvis, distance);
        let spec = RenderSpec {
            pose: turned(standing(2.0 * PI * i as f32 / SIDES as f32), to_world),
            place: Place::Pelvis(place.into()),
            camera: camera.clone(),
            background: Background::Colour(BACKDROP),
            ..RenderSpec::of_frame(renderer.model(), 0)
        };
        Ok(image::DynamicImage::ImageRgba8(renderer.render(&spec)?).into_rgb8())
    };
    let sides = (0..SIDES).map(side).collect::<Result<Vec<_>, _>>()?;
    Ok(inline_jpeg(&strip(&sides, 0, BACKDROP), 85, "the avatar from ten sides"))
}

/// Upright before a camera whose y runs down, turned by `angle`, the arms a little down from the T-pose.
fn standing(angle: f32) -> Pose {
    let mut pose = [0.0; N_POSE];
    // Half a turn about the axis between x and z.
    (pose[0], pose[2]) = (PI * (0.5 * angle).cos(), PI * (0.5 * angle).sin());
    (pose[3 * LEFT_SHOULDER + 2], pose[3 * RIGHT_SHOULDER + 2]) = (-1.0, 1.0);
    pose
}

/// A pose of which the world is turned.
fn turned(mut pose: Pose, by: Mat3) -> Pose {
    let root = Quat::from_scaled_axis(Vec3::from_slice(&pose[..3]));
    pose[..3].copy_from_slice(&(Quat::from_mat3(&by) * root).normalize().to_scaled_axis().to_array());
    pose
}

/// The page. `report` is `report.json`.
pub(super) fn html(report: &Value, quality: &Quality<'_>, curves: &[Point], pictures: &Pictures) -> String {
    let mut page = Page::new("Avatar report");
    page.figures(&headline(report));
    flags(&mut page, quality);
    page.heading("Turntable");
    page.figure(&pictures.turntable, "In the light of the clip.");
    page.heading("Input against fit");
    let most = 100.0 * HEAT_MOST;
    page.paragraph(&format!(
        "The worst {WORST} frames first, then frames spread over the clip. Each shows the input, the avatar over it, and their \
         difference: dark is none, lightest is {most:.0} % of the range or more."
    ));
    page.figure_row(&pictures.frames);
    page.heading("Close up");
    page.paragraph("Face, chest, back and hands, each in the frame that shows it best: the input and the avatar, equally enlarged.");
    page.figure_row(&pictures.closeups);
    losses(&mut page, curves);
    page.heading("Times and memory");
    page.table(&["", "seconds"], &times(report));
    page.paragraph(&memory(report));
    page.heading("Surface");
    page.figures(&surface(quality));
    page.details("Warnings and notes of the reader and of stage 0", &notes(report));
    page.finish()
}

fn number(value: &Value, digits: usize) -> String {
    value.as_f64().map_or("—".to_owned(), |v| format!("{v:.digits$}"))
}

fn headline(report: &Value) -> Vec<(String, String)> {
    let (metrics, stage0, camera) = (&report["metrics"], &report["stage0"], &report["camera"]);
    let named = |name: &str, value: String| (name.to_owned(), value);
    let estimated = if report["camera_estimated"] == true { " (found)" } else { "" };
    vec![
        named("mask IoU", number(&metrics["mask_iou"], 3)),
        named("PSNR", format!("{} dB", number(&metrics["psnr"], 1))),
        named("frames", number(&metrics["frames"], 0)),
        named("picture", format!("{}×{} px", number(&camera["width"], 0), number(&camera["height"], 0))),
        named("turn", format!("{}°", number(&stage0["turn_degrees"], 0))),
        named("focal length", format!("{} px{estimated}", number(&camera["fx"], 0))),
        named("preset", report["options"]["preset"].as_str().unwrap_or("—").to_owned()),
        named("time", format!("{} s", number(&metrics["secs"], 0))),
    ]
}

fn flags(page: &mut Page, quality: &Quality<'_>) {
    page.heading("What to film better");
    if quality.flags.is_empty() {
        page.paragraph("Nothing about this clip was odd.");
    }
    for flag in &quality.flags {
        let value = if flag.value.fract() == 0.0 { flag.value.to_string() } else { rounded(flag.value) };
        let mut more = format!("{}: {value} {}", flag.code, flag.unit);
        if !flag.frames.is_empty() {
            more += &format!("; frames {}", ranges(&flag.frames));
        }
        page.note(&format!("{}.", capitalised(&flag.message)), flag.advice, &more);
    }
}

fn capitalised(text: &str) -> String {
    let mut chars = text.chars();
    chars.next().map_or(String::new(), |first| first.to_uppercase().chain(chars).collect())
}

/// `3, 7–9, 40`
fn ranges(frames: &[u32]) -> String {
    let runs = frames.chunk_by(|a, b| b - a == 1);
    let text = runs.map(|run| match run {
        [one] => one.to_string(),
        [first, .., last] => format!("{first}–{last}"),
        [] => String::new(),
    });
    text.collect::<Vec<_>>().join(", ")
}

fn losses(page: &mut Page, curves: &[Point]) {
    page.heading("Losses");
    let mut charts = Vec::new();
    for (stage, caption) in
        [(Stage::Geometry, "Stage 1: geometry and face colours."), (Stage::Texture, "Stage 2: texture.")]
    {
        let mut lines: BTreeMap<&str, Vec<(f64, f64)>> = BTreeMap::new();
        for point in curves.iter().filter(|point| point.stage == stage) {
            for (name, value) in &point.losses {
                lines.entry(name).or_default().push((f64::from(point.step), *value));
            }
        }
        let lines: Vec<Curve> = lines.into_iter().map(|(name, points)| relative(name, points)).collect();
        if !lines.is_empty() {
            charts.push((chart("step", &lines), caption.to_owned()));
        }
    }
    match charts.is_empty() {
        true => page.paragraph("None were recorded."),
        false => page.paragraph("Each over its own largest value; the number beside its name is the last one."),
    }
    page.figure_row(&charts);
}

/// A term over its largest value: terms have units of their own.
fn relative(name: &str, points: Vec<(f64, f64)>) -> Curve {
    let largest = points.iter().map(|p| p.1).fold(0.0, f64::max);
    let last = points.last().map_or(0.0, |p| p.1);
    let name = match name {
        "normal_consistency" => "normals".to_owned(),
        name => name.replace('_', " "),
    };
    Curve {
        name: format!("{name} {}", rounded(last)),
        points: points.into_iter().map(|(x, y)| (x, y / largest)).collect(),
    }
}

/// Three digits.
fn rounded(value: f64) -> String {
    match value.abs() {
        0.0 => "0".to_owned(),
        large if large >= 100.0 => format!("{value:.0}"),
        middle if middle >= 0.01 => format!("{value:.3}"),
        _ => format!("{value:.1e}"),
    }
}

fn times(report: &Value) -> Vec<Vec<String>> {
    let stages = report["secs"].as_object().into_iter().flatten();
    let mut rows: Vec<(&String, f64)> = stages.map(|(name, secs)| (name, secs.as_f64().unwrap_or(0.0))).collect();
    rows.sort_by_key(|(name, _)| Stage::ALL.iter().position(|stage| stage.name() == *name));
    rows.into_iter().map(|(name, secs)| vec![name.clone(), format!("{secs:.1}")]).collect()
}

fn memory(report: &Value) -> String {
    let mib =
        |value: &Value| value.as_f64().map_or("unknown".to_owned(), |v| format!("{:.0} MiB", v / f64::from(1 << 20)));
    let (memory, device) = (&report["memory"], report["device"]["name"].as_str().unwrap_or("the device"));
    format!(
        "At most {} in the process and {} on {device}.",
        mib(&memory["peak_process_bytes"]),
        mib(&memory["peak_device_bytes"])
    )
}

fn surface(quality: &Quality<'_>) -> Vec<(String, String)> {
    let surface = &quality.surface;
    let percent = |part: f64| format!("{:.1} %", 100.0 * part);
    [
        ("unseen area", percent(surface.unseen_area)),
        ("folded area", percent(surface.flipped_area)),
        ("spikes", format!("{} of {}", surface.spikes, surface.vertices)),
        ("longest edge", format!("{:.1} × the body's", surface.largest_stretch)),
    ]
    .map(|(name, value)| (name.to_owned(), value))
    .to_vec()
}

fn notes(report: &Value) -> String {
    let lines = [&report["warnings"], &report["stage0"]["notes"]];
    let lines = lines.into_iter().flat_map(|list| list.as_array().into_iter().flatten()).filter_map(Value::as_str);
    let items: String = lines.map(|line| format!("<li>{}</li>", crate::page::escape(line))).collect();
    if items.is_empty() { "<p>None.</p>".to_owned() } else { format!("<ul>{items}</ul>") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_frames_come_first_and_none_twice() {
        let score = |frame: u32, psnr: f64| FrameScore { frame, iou: 1.0, psnr };
        let mut scores: Vec<FrameScore> = (0..20).map(|i| score(i, 30.0 + f64::from(i))).collect();
        (scores[8].psnr, scores[15].psnr) = (10.0, 20.0);
        assert_eq!(chosen(&scores), [8, 15, 0, 4, 12, 16]);
        assert_eq!(chosen(&scores[..2]), [0, 1]);
    }

    #[test]
    fn frames_in_a_row_are_a_range() {
        assert_eq!(ranges(&[3, 7, 8, 9, 40, 41]), "3, 7–9, 40–41");
    }
}
