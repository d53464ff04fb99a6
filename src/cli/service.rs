//! What `serve` and `worker` share.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result};
use effigy::jobs::sqlite::SqliteQueue;
use effigy::jobs::{Env, Policy};
use effigy::storage::Store;
use tracing_subscriber::EnvFilter;

#[derive(clap::Args)]
pub struct ServiceArgs {
    /// Where jobs, avatars and bodies are kept [default: the user's data folder].
    #[arg(long, env = "EFFIGY_DATA_DIR")]
    pub data_dir: Option<PathBuf>,
    /// Remove a job's files so many days after its end; without it they stay.
    #[arg(long, value_name = "DAYS")]
    pub retain_days: Option<u64>,
    /// A fit that shows no step for so long hangs: its attempt ends, and the worker's process is started anew.
    #[arg(long, env = "EFFIGY_STALL_SECS", value_name = "SECS", default_value_t = 600)]
    pub stall_secs: u64,
}

impl ServiceArgs {
    pub fn data_dir(&self) -> PathBuf {
        self.data_dir.clone().unwrap_or_else(effigy::data_dir::data_dir)
    }

    pub fn stall(&self) -> Duration {
        Duration::from_secs(self.stall_secs)
    }

    pub fn policy(&self) -> Policy {
        let retention = self.retain_days.map(|days| Duration::from_secs(days.saturating_mul(86_400)));
        Policy { retention, ..Policy::default() }
    }
}

/// Logs to standard error; `EFFIGY_LOG` chooses what, in the form of `tracing`'s filters.
pub fn start_log() {
    let filter = EnvFilter::try_from_env("EFFIGY_LOG").unwrap_or_else(|_| EnvFilter::new("warn,effigy=info"));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .init();
}

pub fn open_store(data_dir: &Path) -> Result<Arc<Store>> {
    let store = Store::open(data_dir).with_context(|| format!("the data folder {}", data_dir.display()))?;
    Ok(Arc::new(store))
}

pub async fn open_queue(store: &Store, env: &Env, policy: Policy) -> Result<Arc<SqliteQueue>> {
    let path = store.database();
    let queue = SqliteQueue::open(&path, env.clone(), policy).await;
    Ok(Arc::new(queue.with_context(|| path.display().to_string())?))
}

/// Until the user or the system asks the process to end.
pub async fn asked_to_end() {
    let interrupt = async {
        if let Err(error) = tokio::signal::ctrl_c().await {
            tracing::error!(%error, "no interrupt will be heard");
            std::future::pending::<()>().await;
        }
    };
    #[cfg(unix)]
    let terminate = async {
        match tokio::signal::unix::signal(tokio::signal::unix::SignalKind::terminate()) {
            Ok(mut signal) => {
                signal.recv().await;
            }
            Err(error) => {
                tracing::error!(%error, "no termination will be heard");
                std::future::pending::<()>().await;
            }
        }
    };
    #[cfg(not(unix))]
    let terminate = std::future::pending::<()>();
    tokio::select! {
        () = interrupt => {}
        () = terminate => {}
    }
}
