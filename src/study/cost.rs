//! What a fit and a picture cost, in the form of the paper's table, and how far two equal runs lie apart.

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context as _, Result};
use glam::Vec3;
use image::RgbImage;

use super::painter::sheet;
use super::{Context, Report, Study, Table, Verdict};
use crate::avatar::{AvatarModel, Place, Pose, RenderSpec, Renderer};
use crate::bench::Ceilings;
use crate::camera::Camera;
use crate::eval::{Novel, NovelPose, Subject};
use crate::picture::Background;
use crate::synth::SynthOptions;

pub const STUDY: Study = Study {
    name: "cost",
    title: "What it costs",
    claim: "Training takes 43.31 minutes and 4.11 GB-hours on average, less than an hour and 5 GB, and a picture of a new \
            pose takes 0.06 s; that is up to 24 times faster to train and 192 times faster to draw than NeRFs",
    section: "§4.3, Training/inference time and compute, and Table 1",
    method: "Each preset runs as a process of its own (`effigy fit`, without given poses), so that its peak memory is its \
             own. Training is stages 0 to 2; the job also decodes the clip, bakes the texture and exports. A picture is one \
             of a pose that the clip does not show, 540 × 540 px, from the model to the finished image on the host, the mean \
             of four after one to warm up, with 1 and with 3 × 3 samples a pixel. Device memory counts all buffers; on a \
             software device it is part of the process. GB-hours are the process's peak times the training time. The paper's \
             lines are its own averages on its GPU and its longer clips: they show the scale and are no comparison of \
             methods. Then the fits run again with the same seed.",
    run: |context| run(context, &Settings::default()),
};

/// What decides size and time.
#[derive(Clone, Debug)]
pub struct Settings {
    pub frames: usize,
    pub size_px: u32,
    pub presets: Vec<&'static str>,
    /// Those of them that run twice
    pub twice: Vec<&'static str>,
    /// Side of the pictures that are timed
    pub picture_px: u32,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            frames: 12,
            size_px: 256,
            presets: vec!["draft", "standard", "paper", "silhouette-only"],
            twice: vec!["standard"],
            picture_px: 540,
        }
    }
}

/// Pictures that are timed, after one that is not.
const PICTURES: u32 = 4;

/// Rounds in which the device's ceilings are measured.
const CEILING_ROUNDS: u32 = 7;

/// Side of a picture of the figure.
const FIGURE_PX: u32 = 270;

/// The paper's Table 4: training minutes, seconds a picture, GB-hours.
const PAPER: [(&str, [f64; 3]); 4] = [
    ("paper: HumanNeRF", [1013.35, 3.51, 399.09]),
    ("paper: AnimNeRF", [769.26, 11.54, 591.38]),
    ("paper: NeuralBody", [1020.27, 0.77, 62.22]),
    ("paper: theirs", [43.31, 0.06, 4.11]),
];
const THEIRS: usize = 3;

/// A finished fit of its own process.
struct Fitted {
    model: Arc<AvatarModel>,
    train_secs: f64,
    job_secs: f64,
    /// `None` where the system does not tell
    process_bytes: Option<f64>,
    device_bytes: f64,
    mask_iou: f64,
    psnr_db: f64,
}

impl Fitted {
    /// The larger of what the process and the device had: a device without a memory of its own has the process's.
    fn most_bytes(&self) -> f64 {
        self.process_bytes.unwrap_or_default().max(self.device_bytes)
    }

    fn gb_hours(&self) -> f64 {
        self.most_bytes() / 1e9 * self.train_secs / 3600.0
    }
}

/// Runs the study at this size; an error where its clip, the device or a fit fails.
pub fn run(context: &Context<'_>, settings: &Settings) -> Result<Report> {
    let clip = SynthOptions {
        frames: settings.frames,
        size_px: settings.size_px,
        seed: context.seed,
        truths: 1,
        ..SynthOptions::default()
    };
    let folder = context.clip(&clip)?;
    let fits = settings.presets.iter().map(|preset| fit(context, &folder, preset)).collect::<Result<Vec<_>>>()?;
    let again = settings.twice.iter().map(|preset| fit(context, &folder, preset)).collect::<Result<Vec<_>>>()?;

    (context.say)("drawing new poses");
    let subject = Subject::open(&folder)?;
    let novel = subject.poses.first().context("the clip has no new pose")?;
    let mut cost = Table::new(
        "Costs",
        "preset",
        &[
            ("training, min", 2),
            ("job, min", 2),
            ("picture, s", 3),
            ("with 3 × 3 samples, s", 3),
            ("device memory, GB", 3),
            ("process memory, GB", 3),
            ("GB-hours", 4),
        ],
    );
    let mut quality = Table::new(
        "What they give, over the frames of the clip",
        "preset",
        &[("IoU of the masks", 4), ("PSNR, dB", 2)],
    );
    let mut pictures = vec![shrink(&novel.on_white()?)];
    let mut picture_secs = Vec::new();
    for (preset, fitted) in settings.presets.iter().zip(&fits) {
        let shot = Shot::new(context, fitted, novel, settings.picture_px)?;
        let secs = [shot.time(1)?, shot.time(3)?];
        picture_secs.push(secs);
        pictures.push(shrink(&shot.picture()?));
        let gb = |bytes: f64| bytes / 1e9;
        cost.row_with_gaps(
            *preset,
            vec![
                Some(fitted.train_secs / 60.0),
                Some(fitted.job_secs / 60.0),
                Some(secs[0]),
                Some(secs[1]),
                Some(gb(fitted.device_bytes)),
                fitted.process_bytes.map(gb),
                Some(fitted.gb_hours()),
            ],
        );
        quality.row(*preset, &[fitted.mask_iou, fitted.psnr_db]);
    }
    for (name, [train, picture, gb_hours]) in PAPER {
        let memory = (name == PAPER[THEIRS].0).then_some(5.0);
        cost.row_with_gaps(name, vec![Some(train), None, Some(picture), None, memory, None, Some(gb_hours)]);
    }
    let ceilings = Ceilings::measure(&context.gpu, CEILING_ROUNDS)?;
    let (spread, pairs) = spread(settings, &fits, &again);
    let mut verdicts = cost_verdicts(&fits, &picture_secs);
    verdicts.extend(spread_verdicts(&pairs));
    let names = settings.presets.join(", ");
    Ok(Report {
        tables: vec![cost, quality, spread],
        figures: vec![(
            sheet(&[pictures]),
            format!("A pose that the clip does not show: the truth, then {names} (each in its own scale)."),
        )],
        verdicts,
        notes: vec![format!(
            "A made clip of {} frames of {}²; time grows with the frames and with their pixels. Times are wall times; when they \
             were taken the device gave {ceilings} (`effigy bench`).",
            settings.frames, settings.size_px
        )],
    })
}

/// Runs a preset in a process of its own.
fn fit(context: &Context<'_>, clip: &Path, preset: &str) -> Result<Fitted> {
    (context.say)(&format!("fitting with {preset}"));
    let out = context.fresh_folder(&format!("cost-{preset}"))?;
    let (clip, folder, seed) = (clip.to_string_lossy(), out.to_string_lossy(), context.seed.to_string());
    context.run_effigy(&[
        "fit",
        &clip,
        "--preset",
        preset,
        "--out",
        &folder,
        "--seed",
        &seed,
        "--body",
        &context.body,
        "--json",
    ])?;
    read(&out)
}

/// What `effigy fit` left.
fn read(out: &Path) -> Result<Fitted> {
    let path = out.join("report.json");
    let bytes = std::fs::read(&path).with_context(|| path.display().to_string())?;
    let report: serde_json::Value = serde_json::from_slice(&bytes)?;
    let number = |pointer: &str| {
        let value = report.pointer(pointer).and_then(serde_json::Value::as_f64);
        value.with_context(|| format!("{}: no number at {pointer}", path.display()))
    };
    Ok(Fitted {
        model: Arc::new(AvatarModel::load(&out.join("model.npz"))?),
        train_secs: number("/secs/pose")? + number("/secs/geometry")? + number("/secs/texture")?,
        job_secs: number("/metrics/secs")?,
        process_bytes: number("/memory/peak_process_bytes").ok(),
        device_bytes: number("/memory/peak_device_bytes")?,
        mask_iou: number("/metrics/mask_iou")?,
        psnr_db: number("/metrics/psnr")?,
    })
}

/// An avatar about to be drawn in a new pose.
struct Shot {
    renderer: Renderer,
    spec: RenderSpec,
}

impl Shot {
    fn new(context: &Context<'_>, fitted: &Fitted, novel: &Novel, side: u32) -> Result<Self> {
        let model = &fitted.model;
        let pose: Pose = match &novel.pose {
            NovelPose::Pose(pose, _) => **pose,
            NovelPose::Frame(_) => model.poses[0],
        };
        let camera: Camera = model.camera.scaled(side, side);
        let place = Place::Transl(model.transl[0]);
        let background = Background::Colour([255; 3]);
        let spec = RenderSpec { pose, place, camera, background, ..RenderSpec::of_frame(model, 0) };
        Ok(Self { renderer: Renderer::new(&context.gpu, model)?, spec })
    }

    fn picture(&self) -> Result<RgbImage> {
        Ok(image::DynamicImage::ImageRgba8(self.renderer.render(&self.spec)?).into_rgb8())
    }

    /// Seconds a picture.
    fn time(&self, samples: u32) -> Result<f64> {
        let spec = RenderSpec { samples, ..self.spec.clone() };
        self.renderer.render(&spec)?;
        let start = Instant::now();
        for _ in 0..PICTURES {
            self.renderer.render(&spec)?;
        }
        Ok(start.elapsed().as_secs_f64() / PICTURES as f64)
    }
}

fn shrink(picture: &RgbImage) -> RgbImage {
    image::imageops::resize(picture, FIGURE_PX, FIGURE_PX, image::imageops::FilterType::CatmullRom)
}

/// How far two runs of a preset lie apart.
struct Pair {
    preset: &'static str,
    mean_mm: f64,
    max_mm: f64,
    psnr_db: f64,
}

fn spread(settings: &Settings, fits: &[Fitted], again: &[Fitted]) -> (Table, Vec<Pair>) {
    let mut table = Table::new(
        "The same fit twice: differences",
        "preset",
        &[("vertices, mean mm", 4), ("max mm", 3), ("IoU of the masks", 6), ("PSNR, dB", 4)],
    );
    let mut pairs = Vec::new();
    for (&preset, second) in settings.twice.iter().zip(again) {
        let Some(first) = settings.presets.iter().position(|p| *p == preset).map(|i| &fits[i]) else { continue };
        let (mean_mm, max_mm) = vertex_difference_mm(&first.model, &second.model);
        let psnr_db = (first.psnr_db - second.psnr_db).abs();
        table.row(preset, &[mean_mm, max_mm, (first.mask_iou - second.mask_iou).abs(), psnr_db]);
        pairs.push(Pair { preset, mean_mm, max_mm, psnr_db });
    }
    (table, pairs)
}

/// Mean and greatest distance between the vertices of two models, posed as in each captured frame.
fn vertex_difference_mm(a: &AvatarModel, b: &AvatarModel) -> (f64, f64) {
    let (mut sum, mut max, mut n) = (0.0, 0.0f64, 0);
    for k in 0..a.poses.len().min(b.poses.len()) {
        let (ours, theirs) = (a.posed(&a.poses[k], a.transl[k]).vertices, b.posed(&b.poses[k], b.transl[k]).vertices);
        for (p, q) in ours.iter().zip(&theirs) {
            let mm = 1e3 * Vec3::from(*p).distance(Vec3::from(*q)) as f64;
            (sum, max, n) = (sum + mm, max.max(mm), n + 1);
        }
    }
    (sum / n.max(1) as f64, max)
}

fn cost_verdicts(fits: &[Fitted], picture_secs: &[[f64; 2]]) -> Vec<Verdict> {
    let most = |value: &dyn Fn(&Fitted) -> f64| fits.iter().map(value).fold(0.0, f64::max);
    let minutes = most(&|f| f.train_secs / 60.0);
    let gigabytes = most(&|f| f.most_bytes() / 1e9);
    let [one, nine] = [0, 1].map(|k| picture_secs.iter().map(|secs| secs[k]).fold(0.0, f64::max));
    let [_, paper_picture, _] = PAPER[THEIRS].1;
    vec![
        Verdict::new(
            "This clip trains in less than an hour and 5 GB, whatever the preset",
            minutes < 60.0 && gigabytes < 5.0,
            format!("at most {minutes:.1} min and {gigabytes:.2} GB"),
        ),
        Verdict::new(
            format!(
                "A picture of a new pose, with 3 × 3 samples a pixel, takes no longer than the paper's {paper_picture} s"
            ),
            nine <= paper_picture,
            format!("{nine:.3} s; with one sample {one:.3} s"),
        ),
    ]
}

fn spread_verdicts(pairs: &[Pair]) -> Vec<Verdict> {
    let list = |value: &dyn Fn(&Pair) -> String| {
        pairs.iter().map(|p| format!("{}: {}", p.preset, value(p))).collect::<Vec<_>>().join(", ")
    };
    vec![
        Verdict::new(
            "The same seed gives the same avatar, bit by bit",
            pairs.iter().all(|p| p.max_mm == 0.0 && p.psnr_db == 0.0),
            list(&|p| format!("{:.3} mm at most", p.max_mm)),
        ),
        Verdict::new(
            "Two runs differ by less than a millimetre on average and 0.1 dB",
            pairs.iter().all(|p| p.mean_mm < 1.0 && p.psnr_db < 0.1),
            list(&|p| format!("{:.3} mm, {:.3} dB", p.mean_mm, p.psnr_db)),
        ),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::avatar::testing::turning_avatar;

    #[test]
    fn a_shifted_frame_is_seen_in_mean_and_maximum() {
        let a = turning_avatar();
        let mut b = a.clone();
        assert_eq!(vertex_difference_mm(&a, &b), (0.0, 0.0));
        b.transl[0][1] += 0.003;
        let (mean, max) = vertex_difference_mm(&a, &b);
        assert!((max - 3.0).abs() < 1e-3 && (mean - 3.0 / a.poses.len() as f64).abs() < 1e-3, "{mean} {max}");
    }
}
