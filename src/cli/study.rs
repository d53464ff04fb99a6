//! `effigy study`: the paper's claims, measured.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context as _, Result};
use effigy::data_dir::data_dir;
use effigy::gpu::{DeviceSelect, Gpu};
use effigy::study::{Context, STUDIES, Saved, Study, document, study};

#[derive(clap::Args)]
pub struct Args {
    /// A study's name; `all` runs every one, `page` only writes the page anew.
    name: String,
    /// Folder for the numbers and pictures; the page of all results goes beside it (`docs/results.md`).
    #[arg(long, default_value = "docs/results")]
    out: PathBuf,
    /// Decides everything random.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// A body's name in the data folder, or `test` for the small built-in one.
    #[arg(long, default_value = "default")]
    body: String,
    /// Folder for clips and avatars in between [default: `studies` in the data folder].
    #[arg(long)]
    work: Option<PathBuf>,
}

pub fn run(args: Args) -> Result<()> {
    let chosen: Vec<&Study> = match args.name.as_str() {
        "all" => STUDIES.iter().collect(),
        "page" => Vec::new(),
        name => vec![study(name).with_context(|| unknown(name))?],
    };
    let spinner = super::spinner();
    let say = |what: &str| spinner.set_message(what.to_owned());
    if !chosen.is_empty() {
        let context = Context {
            gpu: Gpu::open(&DeviceSelect::Auto)?,
            body: args.body,
            seed: args.seed,
            work: args.work.unwrap_or_else(|| data_dir().join("studies")),
            effigy: std::env::current_exe()?,
            say: &say,
        };
        for study in chosen {
            say(study.title);
            let started = Instant::now();
            let report = (study.run)(&context).with_context(|| format!("study {}", study.name))?;
            let saved = report.save(study, &context, started.elapsed().as_secs_f64(), &args.out)?;
            spinner.suspend(|| print(study, &saved));
        }
    }
    spinner.finish_and_clear();
    let page = args.out.with_extension("md");
    std::fs::write(&page, document(&args.out)?).with_context(|| page.display().to_string())?;
    println!("wrote {}", page.display());
    Ok(())
}

fn unknown(name: &str) -> String {
    let names: Vec<&str> = STUDIES.iter().map(|s| s.name).collect();
    format!("study {name:?}: expected all, page or one of {}", names.join(", "))
}

fn print(study: &Study, saved: &Saved) {
    println!("{} ({:.0} s)\n", study.title, saved.secs);
    for table in &saved.tables {
        println!("{}\n{}", table.caption, table.markdown());
    }
    for verdict in &saved.verdicts {
        let holds = if verdict.holds { "holds" } else { "does not hold" };
        println!("{holds}: {} ({})", verdict.claim, verdict.evidence);
    }
    println!();
}
