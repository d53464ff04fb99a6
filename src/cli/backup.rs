//! `effigy backup` and `effigy restore`. docs/operating.md tells how they are used.
//!
//! A backup is a data folder of its own: the database as it was at one moment, the bodies, and the files of the jobs in
//! it. `backup.json` comes last; without it a backup is not whole.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use effigy::atomic_file;
use effigy::jobs::sqlite::backup::{self, Kept};
use effigy::jobs::{Env, State};
use effigy::storage::{Copied, How, Published, Store};
use serde::{Deserialize, Serialize};
use uuid::Uuid;

use super::service::{open_store, tell_of_owner};
use super::settings::CommonFlags;

#[derive(clap::Args)]
pub struct BackupArgs {
    /// A folder that does not exist or is empty.
    folder: PathBuf,
    #[command(flatten)]
    settings: CommonFlags,
}

#[derive(clap::Args)]
pub struct RestoreArgs {
    /// What `effigy backup` made.
    folder: PathBuf,
    #[command(flatten)]
    settings: CommonFlags,
}

/// `backup.json`
#[derive(Serialize, Deserialize)]
struct Manifest {
    effigy: String,
    made_at: String,
    jobs: usize,
    files: u64,
    bytes: u64,
}

const MANIFEST: &str = "backup.json";

#[tokio::main(flavor = "current_thread")]
pub async fn run(args: BackupArgs) -> Result<()> {
    let in_force = args.settings.resolve()?;
    let data = in_force.config.data_dir();
    // Before it is opened, which would make it.
    ensure!(data.join("effigy.db").exists(), "there is no database in {}", data.display());
    let live = open_store(&data)?;
    let empty = !args.folder.exists() || args.folder.read_dir()?.next().is_none();
    ensure!(empty, "{} is not empty: each backup has a folder of its own", args.folder.display());
    let copy = open_store(&args.folder)?;
    // The database first: files that come later belong to jobs that it does not know, and are not looked at.
    let now = Env::system().now();
    backup::copy(&live.database(), &copy.database(), now).await?;
    let mut copied = live.copy_bodies(&copy, How::Link)?;
    let (mut jobs, mut gone) = (0, Vec::new());
    for job in backup::contents(&copy.database()).await? {
        copied += live.copy_job(&copy, job.id, job.results.as_ref().map(|(epoch, _)| *epoch), How::Link)?;
        if lacking(&copy, &job).is_none() {
            jobs += 1;
            continue;
        }
        // Deleted, or expired, since the database was copied: here it never was. Anything else is damage.
        if let Some(path) = lacking(&live, &job).filter(|path| path.ancestors().nth(2).is_some_and(Path::exists)) {
            bail!("{} is missing or has another size than the database says: the store is damaged", path.display());
        }
        copy.delete_job(job.id)?;
        gone.push(job.id);
    }
    backup::forget(&copy.database(), &gone).await?;
    let manifest = Manifest {
        effigy: env!("CARGO_PKG_VERSION").into(),
        made_at: now.rfc3339(),
        jobs,
        files: copied.files,
        bytes: copied.bytes,
    };
    atomic_file::write(&copy.root().join(MANIFEST), serde_json::to_string_pretty(&manifest)?.as_bytes())?;
    println!("{} jobs, {} files, {} bytes in {}", jobs, copied.files, copied.bytes, copy.root().display());
    Ok(())
}

/// The first file of a job that a store lacks.
fn lacking(store: &Store, job: &Kept) -> Option<PathBuf> {
    // The files of an expired job are meant to be gone.
    let inputs = if job.state == State::Expired { &[][..] } else { &job.inputs };
    let results = job.results.as_ref().and_then(|(epoch, files)| {
        store.missing(&store.results(job.id, *epoch), files.iter().map(|file| (file.name.clone(), file.bytes)))
    });
    store.missing(&store.inputs(job.id), inputs.iter().cloned()).or(results)
}

#[tokio::main(flavor = "current_thread")]
pub async fn restore(args: RestoreArgs) -> Result<()> {
    let manifest = std::fs::read(args.folder.join(MANIFEST));
    let manifest = manifest.with_context(|| format!("{} is no whole backup: {MANIFEST}", args.folder.display()))?;
    let manifest: Manifest = serde_json::from_slice(&manifest).context(MANIFEST)?;
    let from = open_store(&args.folder)?;
    let in_force = args.settings.resolve()?;
    let to = open_store(&in_force.config.data_dir())?;
    let Some(_lock) = to.lock_server().context("serve.lock in the data folder")? else {
        bail!("a server uses the data folder {}", to.root().display())
    };
    // Of a database that was moved away alone, SQLite would replay the journal into the restored one.
    for file in to.database_files() {
        ensure!(!file.exists(), "{} exists: move {} away first", file.display(), Store::OF_THE_QUEUE);
    }
    let health = backup::examine(&from.database()).await?;
    ensure!(health.integrity == "ok", "the backup's database is damaged: {}", health.integrity);
    ensure!(health.version <= health.known, "the backup was made by a newer version ({})", manifest.effigy);
    let jobs = backup::contents(&from.database()).await?;
    for job in &jobs {
        check(&from, job)?;
    }
    let kept: HashSet<Uuid> = jobs.iter().map(|job| job.id).collect();
    if let Some(other) = to.job_folders()?.into_iter().find(|job| !kept.contains(job)) {
        // The next server would take it for the remains of an upload.
        bail!("{} is of a job that the backup does not have: move {} away first", other, Store::OF_THE_QUEUE);
    }
    let mut copied = from.copy_bodies(&to, How::Copy)?;
    for job in &jobs {
        copied += from.copy_job(&to, job.id, job.results.as_ref().map(|(epoch, _)| *epoch), How::Copy)?;
    }
    // The database comes last: a restore that was interrupted can be begun again.
    atomic_file::write(&to.database(), &std::fs::read(from.database())?)?;
    let Copied { files, bytes } = copied;
    println!(
        "{} jobs, {files} files, {bytes} bytes in {}, as of {}",
        jobs.len(),
        to.root().display(),
        manifest.made_at
    );
    tell_of_owner(&to)
}

/// Whether a backup has all files of a job, the results as they were published.
fn check(store: &Store, job: &Kept) -> Result<()> {
    if let Some(path) = lacking(store, job) {
        bail!("the backup is damaged: {} is missing or has another size", path.display());
    }
    if let Some((epoch, files)) = &job.results {
        let folder = store.results(job.id, *epoch);
        for found in Published::seal(&folder)? {
            let known = files.iter().find(|file| file.name == found.name);
            ensure!(
                known.is_none_or(|file| file.sha256 == found.sha256),
                "the backup is damaged: {} does not have its checksum",
                folder.join(found.name).display()
            );
        }
    }
    Ok(())
}
