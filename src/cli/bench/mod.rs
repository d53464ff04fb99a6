//! `effigy bench`: times the operators on this device and compares them with what the device gives at best.
//!
//! Another operator is a [`Case`] more in [`frame`].

mod device;
mod frame;

use std::time::Instant;

use anyhow::{Context, Result};
use effigy::body::Body;
use effigy::data_dir::body_path;
use effigy::gpu::{DeviceInfo, DeviceSelect, Gpu, Recorder};

#[derive(clap::Args)]
pub struct Args {
    /// Only what has this text in its name.
    filter: Option<String>,
    /// A body file or the name of a body; by default the default body, or the small test body where there is none.
    #[arg(long)]
    body: Option<String>,
    /// Side of the square image, pixels.
    #[arg(long, default_value_t = 540, value_parser = clap::value_parser!(u32).range(16..=4096))]
    size: u32,
    /// Timed calls of each operator; the median counts.
    #[arg(long, default_value_t = 15, value_parser = clap::value_parser!(u32).range(1..))]
    repeats: u32,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

/// One thing to time. `bytes` and `flops` are what the contract cannot do without: every input read once, every result
/// written once, gathers and scatters counted each; a fused multiply-add is two.
struct Case<'a> {
    name: &'static str,
    bytes: f64,
    /// `None` where the work depends on the scene.
    flops: Option<f64>,
    record: Box<dyn Fn(&mut Recorder<'_>) + 'a>,
}

#[derive(serde::Serialize)]
struct Line {
    op: &'static str,
    ms: f64,
    gb_per_s: f64,
    gflop_per_s: Option<f64>,
}

#[derive(serde::Serialize)]
struct Report<'a> {
    device: &'a DeviceInfo,
    body: String,
    vertices: usize,
    faces: usize,
    size_px: u32,
    covered_px: usize,
    repeats: u32,
    ops: Vec<Line>,
}

pub fn run(args: Args) -> Result<()> {
    let body = load_body(args.body.as_deref())?;
    let gpu = Gpu::open(&DeviceSelect::Auto)?;
    let ceilings = device::Ceilings::new(&gpu);
    let frame = frame::Frame::new(&gpu, &body, args.size)?;
    let mut report = Report {
        device: gpu.info(),
        body: body.name.clone(),
        vertices: body.n_vertices(),
        faces: body.n_faces(),
        size_px: args.size,
        covered_px: frame.covered(),
        repeats: args.repeats,
        ops: Vec::new(),
    };
    if !args.json {
        print_head(&report);
    }
    for case in ceilings.cases().into_iter().chain(frame.cases()) {
        if args.filter.as_ref().is_some_and(|text| !case.name.contains(text.as_str())) {
            continue;
        }
        let line = measure(&gpu, &case, args.repeats)?;
        if !args.json {
            print_line(&line);
        }
        report.ops.push(line);
    }
    if args.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    }
    Ok(())
}

fn load_body(name: Option<&str>) -> Result<Body> {
    let path = match name {
        Some(name) if std::path::Path::new(name).is_file() => name.into(),
        Some(name) => body_path(name),
        None => body_path("default"),
    };
    if name.is_none() && !path.is_file() {
        return Ok(Body::test_body());
    }
    Body::load(&path).with_context(|| path.display().to_string())
}

/// The median wall time of a submission that is awaited, after one call that compiles and warms up.
fn measure(gpu: &Gpu, case: &Case<'_>, repeats: u32) -> Result<Line> {
    let once = || -> Result<f64> {
        let start = Instant::now();
        let mut recorder = gpu.recorder(case.name);
        (case.record)(&mut recorder);
        recorder.submit()?;
        gpu.wait()?;
        Ok(start.elapsed().as_secs_f64())
    };
    once()?;
    let mut secs = (0..repeats).map(|_| once()).collect::<Result<Vec<f64>>>()?;
    secs.sort_by(f64::total_cmp);
    let median = secs[secs.len() / 2];
    Ok(Line {
        op: case.name,
        ms: median * 1e3,
        gb_per_s: case.bytes / median * 1e-9,
        gflop_per_s: case.flops.map(|flops| flops / median * 1e-9),
    })
}

fn print_head(report: &Report<'_>) {
    let Report { device, body, vertices, faces, size_px, covered_px, repeats, .. } = report;
    println!("{} ({}, {})", device.name, device.backend, device.driver);
    println!("body {body}: {vertices} vertices, {faces} faces; {size_px} × {size_px} pixels, {covered_px} covered");
    println!("medians of {repeats} calls\n");
    println!("{:<28}{:>10}{:>10}{:>12}", "op", "ms", "GB/s", "GFLOP/s");
}

fn print_line(line: &Line) {
    let flops = line.gflop_per_s.map_or("–".to_owned(), |x| format!("{x:.2}"));
    println!("{:<28}{:>10.3}{:>10.2}{:>12}", line.op, line.ms, line.gb_per_s, flops);
}
