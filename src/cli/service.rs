//! What `serve` and `worker` share.

use std::io::IsTerminal;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use effigy::config::{Auth, Config, LogFormat};
use effigy::http::Openness;
use effigy::jobs::keys::Keys;
use effigy::jobs::sqlite::SqliteQueue;
use effigy::jobs::{Env, Policy, QueueError};
use effigy::storage::Store;
use effigy::telemetry::Exporter;
use effigy::webhooks::install_cryptography;
use tracing_subscriber::filter::LevelFilter;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{EnvFilter, Layer};

use super::settings::InForce;

pub fn policy(config: &Config) -> Policy {
    let retention = config.retain_days.map(|days| Duration::from_secs(u64::from(days) * 86_400));
    Policy { retention, max_queued: config.max_queued.into(), ..Policy::default() }
}

/// What keys there are.
#[derive(Clone, Copy)]
pub struct KeysFound {
    /// One that opens something.
    pub living: bool,
    /// Any, ended ones too.
    pub any: bool,
}

impl KeysFound {
    pub async fn of(keys: &dyn Keys) -> Result<KeysFound> {
        Ok(KeysFound { living: keys.any_living_key().await?, any: keys.any_key().await? })
    }
}

/// Whom a server listens to. What others can reach does not open by mistake: `None` where it would without a key, and no
/// server starts.
pub fn openness(config: &Config, keys: KeysFound) -> Option<Openness> {
    match config.auth {
        Auth::Open => Some(Openness::Open),
        Auth::Auto if config.listen.ip().is_loopback() && !keys.any => Some(Openness::Local),
        Auth::Auto if !config.listen.ip().is_loopback() && !keys.living => None,
        Auth::Auto | Auth::Keys => Some(Openness::Keys),
    }
}

/// Whether the queue is what failed, and in this way.
pub fn is_queues(error: &anyhow::Error, way: fn(&QueueError) -> bool) -> bool {
    error.chain().filter_map(|e| e.downcast_ref::<QueueError>()).any(way)
}

/// What is logged.
pub fn log_filter(config: &Config) -> Result<EnvFilter> {
    EnvFilter::try_new(&config.log).with_context(|| format!("the setting log, {:?}", config.log))
}

/// Logs to standard error, and sends spans where a collector is set: until what is returned is dropped.
pub fn start_log(in_force: &InForce, role: &'static str) -> Result<Option<Exporter>> {
    let config = &in_force.config;
    let filter = log_filter(config)?;
    let (spans, exporter) = match &config.otlp_endpoint {
        None => (None, None),
        Some(endpoint) => {
            install_cryptography();
            let (spans, exporter) = Exporter::start(endpoint, role)?;
            // Spans do not depend on what is logged.
            (Some(spans.with_filter(LevelFilter::INFO)), Some(exporter))
        }
    };
    let log = tracing_subscriber::fmt::layer().with_writer(std::io::stderr);
    let log = match config.log_format {
        LogFormat::Text => log.with_ansi(std::io::stderr().is_terminal()).with_filter(filter).boxed(),
        LogFormat::Json => log.json().flatten_event(true).with_current_span(false).with_filter(filter).boxed(),
    };
    tracing_subscriber::registry().with(log).with(spans).init();
    for (name, nearest) in &in_force.strange {
        tracing::warn!("{name} is no setting; did you mean {nearest}?");
    }
    Ok(exporter)
}

pub fn open_store(data_dir: &Path) -> Result<Arc<Store>> {
    Ok(Arc::new(open(data_dir)?))
}

/// For those who bring new files: they keep the disk's reserve free.
pub fn open_with_reserve(config: &Config) -> Result<Arc<Store>> {
    Ok(Arc::new(open(&config.data_dir())?.with_reserve(config.disk_reserve_bytes.0)))
}

fn open(data_dir: &Path) -> Result<Store> {
    Store::open(data_dir).with_context(|| format!("the data folder {}", data_dir.display()))
}

/// The queue, made where the data folder is new. A folder that has jobs and no database has lost it: an empty one would take
/// their files for rubbish.
pub async fn open_queue(store: &Store, env: &Env, policy: Policy) -> Result<Arc<SqliteQueue>> {
    let path = store.database();
    if !path.exists() {
        let orphans = store.job_folders()?.len();
        ensure!(
            orphans == 0,
            "{} is missing, and there are files of {orphans} jobs: put it back, or move {} away and restore a backup",
            path.display(),
            Store::OF_THE_QUEUE
        );
    }
    let queue = SqliteQueue::open(&path, env.clone(), policy).await;
    let queue = queue.map_err(|error| {
        let mend = if error.is_refused() { format!(" ({OWN})") } else { String::new() };
        anyhow::Error::new(error).context(format!("{}{mend}", path.display()))
    });
    Ok(Arc::new(queue?))
}

/// What helps against files of another user.
pub const OWN: &str = "give it and its folder to the user who runs the service: chown -R";

/// Says on standard error where what a command has written is not the user's who has the data folder.
pub fn tell_of_owner(store: &Store) -> Result<()> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        let (folder, written) = (std::fs::metadata(store.root())?.uid(), std::fs::metadata(store.database())?.uid());
        if folder != written {
            let root = store.root().display();
            eprintln!(
                "The database belongs to the user {written}, the data folder to {folder}: a service that runs as the latter \
                 cannot write it before `chown -R {folder} {root}`."
            );
        }
    }
    Ok(())
}

/// Hears from now on whether the user or the system asks the process to end; done when one of them does.
#[cfg(unix)]
pub fn asked_to_end() -> impl Future<Output = ()> + Send {
    use tokio::signal::unix::{Signal, SignalKind, signal};
    let hear = |kind| signal(kind).inspect_err(|error| tracing::error!(%error, ?kind, "this signal will not be heard"));
    async fn heard(signal: std::io::Result<Signal>) {
        match signal {
            Ok(mut signal) => {
                signal.recv().await;
            }
            Err(_) => std::future::pending().await,
        }
    }
    let (interrupt, terminate) = (hear(SignalKind::interrupt()), hear(SignalKind::terminate()));
    async {
        tokio::select! {
            () = heard(interrupt) => {}
            () = heard(terminate) => {}
        }
    }
}

/// Done when the user asks the process to end.
#[cfg(not(unix))]
pub fn asked_to_end() -> impl Future<Output = ()> + Send {
    async {
        if let Err(error) = tokio::signal::ctrl_c().await {
            tracing::error!(%error, "no interrupt will be heard");
            std::future::pending::<()>().await;
        }
    }
}
