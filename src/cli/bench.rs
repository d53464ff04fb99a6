//! `effigy bench`: times the work on this device and compares it with what the device gives at best.

use std::collections::BTreeMap;

use anyhow::{Context, Result};
use effigy::bench::{
    Ceilings, Counts, Frame, Peaks, PictureBench, PictureTimes, Scale, Step, StepBench, StepTimes, Times, cores,
    interleaved,
};
use effigy::body::Body;
use effigy::data_dir::body_path;
use effigy::gpu::{DeviceInfo, DeviceSelect, Gpu, KernelTime};

#[derive(clap::Args)]
pub struct Args {
    /// Only what has this text in its name.
    filter: Option<String>,
    /// A body file or the name of a body; by default the default body, or the small test body where there is none.
    #[arg(long)]
    body: Option<String>,
    /// Reduce the body to so many faces; 13776 is the size of SMPL (6,890 vertices).
    #[arg(long)]
    faces: Option<usize>,
    /// Sides of the square images, pixels.
    #[arg(long, default_value = "540", value_delimiter = ',', value_parser = clap::value_parser!(u32).range(16..=4096))]
    size: Vec<u32>,
    /// Frames of a step.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=64))]
    frames: u32,
    /// Timed rounds over all operators.
    #[arg(long, default_value_t = 15, value_parser = clap::value_parser!(u32).range(1..))]
    repeats: u32,
    /// Split the steps by kernel instead of by operator.
    #[arg(long)]
    kernels: bool,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

#[derive(serde::Serialize)]
struct Line {
    op: &'static str,
    #[serde(flatten)]
    times: Times,
    #[serde(flatten)]
    needs: Counts,
    /// What the work takes when it has the device for itself.
    alone_ms: f64,
    /// What it takes at least on a device of these ceilings, and `alone_ms` over that.
    floor_ms: f64,
    ratio: f64,
}

#[derive(serde::Serialize)]
struct Scene {
    size_px: u32,
    scale: Scale,
    ops: Vec<Line>,
    steps: Vec<StepTimes>,
    /// A picture of an avatar, 3×3 samples a pixel.
    picture: Option<PictureTimes>,
}

#[derive(serde::Serialize)]
struct Report<'a> {
    device: &'a DeviceInfo,
    body: String,
    vertices: usize,
    faces: usize,
    repeats: u32,
    ceilings: Peaks,
    scenes: Vec<Scene>,
}

pub fn run(args: Args) -> Result<()> {
    let body = load_body(&args)?;
    let gpu = Gpu::open(&DeviceSelect::Auto)?;
    let peaks = Ceilings::measure(&gpu, args.repeats)?;
    let mut report = Report {
        device: gpu.info(),
        body: body.name.clone(),
        vertices: body.n_vertices(),
        faces: body.n_faces(),
        repeats: args.repeats,
        ceilings: peaks,
        scenes: Vec::new(),
    };
    if !args.json {
        print_head(&report);
    }
    for &size_px in &args.size {
        let frame = Frame::new(&gpu, &body, size_px)?;
        let mut cases = frame.cases();
        cases.retain(|case| args.filter.as_ref().is_none_or(|text| case.name.contains(text.as_str())));
        let times = interleaved(&gpu, &cases, args.repeats)?;
        let line = |(case, times): (&effigy::bench::Case<'_>, Times)| {
            let (alone_ms, floor_ms) = (times.alone_ms(&gpu), peaks.floor_ms(case.needs));
            Line { op: case.name, times, alone_ms, needs: case.needs, floor_ms, ratio: alone_ms / floor_ms }
        };
        let ops = cases.iter().zip(times).map(line).collect();
        let mut scene = Scene { size_px, scale: frame.scale(), ops, steps: Vec::new(), picture: None };
        if !args.json {
            print_scene(&scene);
        }
        drop(cases);
        drop(frame);
        let steps = StepBench::new(&gpu, &body, size_px, args.frames as usize)?;
        for step in Step::ALL {
            if args.filter.as_ref().is_none_or(|text| step.name().contains(text.as_str())) {
                let step = steps.run(step, args.repeats)?;
                if !args.json {
                    print_step(&gpu, &step, args.kernels);
                }
                scene.steps.push(step);
            }
        }
        if args.filter.as_ref().is_none_or(|text| "picture".contains(text.as_str())) {
            let picture = PictureBench::new(&gpu, &body, size_px)?.run(args.repeats)?;
            if !args.json {
                print_picture(&gpu, &picture, args.kernels);
            }
            scene.picture = Some(picture);
        }
        report.scenes.push(scene);
    }
    if args.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    }
    Ok(())
}

fn load_body(args: &Args) -> Result<Body> {
    let path = match &args.body {
        Some(name) if std::path::Path::new(name).is_file() => name.into(),
        Some(name) => body_path(name),
        None => body_path("default"),
    };
    let body = if args.body.is_none() && !path.is_file() {
        Body::test_body()
    } else {
        Body::load(&path).with_context(|| path.display().to_string())?
    };
    Ok(match args.faces {
        Some(n_faces) => effigy::body::import::reduced(body, n_faces),
        None => body,
    })
}

fn print_head(report: &Report<'_>) {
    let Report { device, body, vertices, faces, repeats, ceilings, .. } = report;
    println!("{} ({}, {})", device.name, device.backend, device.driver);
    println!("ceilings: {ceilings}");
    println!("body {body}: {vertices} vertices, {faces} faces; {repeats} rounds; ratio = alone / floor");
}

fn print_scene(scene: &Scene) {
    let Scene { size_px, scale, ops, .. } = scene;
    println!("\n{size_px} × {size_px} pixels, {} covered", scale.covered);
    let head = ["alone ms", "best ms", "median ms", "MB", "MFLOP", "floor ms", "ratio"];
    println!("{:<28}{}", "op", head.map(|h| format!("{h:>11}")).concat());
    for Line { op, times, alone_ms, needs, floor_ms, ratio } in ops {
        println!(
            "{op:<28}{alone_ms:>11.3}{:>11.3}{:>11.3}{:>11.2}{:>11.1}{floor_ms:>11.3}{ratio:>11.1}",
            times.best_ms,
            times.median_ms,
            1e-6 * needs.bytes,
            1e-6 * needs.flops
        );
    }
}

/// Where a step's time goes. The parts were run one by one: their sum is more than the step by what a launch costs.
fn print_step(gpu: &Gpu, step: &StepTimes, by_kernel: bool) {
    let StepTimes { step, frames, times, row, kernels, peak_device_bytes } = step;
    println!(
        "\n{} of {frames} × {}: alone {:.2} ms, best {:.2}, median {:.2}; in a row {:.2}, the host's part {:.2}; {:.0} MB of device memory",
        step.name(),
        if *frames == 1 { "frame" } else { "frames" },
        times.alone_ms(gpu),
        times.best_ms,
        times.median_ms,
        row.ms,
        row.host_ms,
        1e-6 * *peak_device_bytes as f64
    );
    print_kernels(gpu, kernels, by_kernel);
}

fn print_picture(gpu: &Gpu, picture: &PictureTimes, by_kernel: bool) {
    let PictureTimes { times: Times { best_ms, median_ms, cpu_ms, .. }, kernels } = picture;
    println!("\na picture, 3×3 samples a pixel: best {best_ms:.1} ms, median {median_ms:.1}; {cpu_ms:.1} of CPU time");
    print_kernels(gpu, kernels, by_kernel);
}

fn print_kernels(gpu: &Gpu, kernels: &BTreeMap<String, KernelTime>, by_kernel: bool) {
    let mut parts = BTreeMap::<&str, (u64, f64)>::new();
    for (kernel, time) in kernels {
        let name = if by_kernel { kernel } else { kernel.split('/').next().unwrap_or(kernel) };
        let part = parts.entry(name).or_default();
        let ms = if gpu.info().software { 1e3 * time.cpu_secs / cores() } else { 1e3 * time.secs };
        *part = (part.0 + time.calls, part.1 + ms);
    }
    let mut parts: Vec<_> = parts.into_iter().collect();
    parts.sort_by(|a, b| b.1.1.total_cmp(&a.1.1));
    println!("{:<34}{:>11}{:>11}", "part", "commands", "alone ms");
    for (name, (calls, ms)) in parts {
        println!("{name:<34}{calls:>11}{ms:>11.3}");
    }
}
