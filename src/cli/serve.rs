//! `effigy serve`: the API and, as a child process, its worker.

use std::collections::HashSet;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use effigy::http::{App, ClipInspector, Limits};
use effigy::jobs::render::{NoRenderer, Renderer};
use effigy::jobs::{Env, Queue};
use effigy::storage::Store;
use effigy::worker::{Reaper, Supervisor, SupervisorSettings};

use super::service::{ServiceArgs, asked_to_end, open_queue, open_store, start_log};

#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    service: ServiceArgs,
    /// Address and port to listen on; port 0 takes a free one and prints it.
    #[arg(long, env = "EFFIGY_LISTEN", default_value = "127.0.0.1:8080")]
    listen: SocketAddr,
    /// 1: supervise a worker as a child process. 0: the API alone, for workers started by `effigy worker`.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u8).range(0..=1))]
    workers: u8,
    /// Largest upload, all parts together.
    #[arg(long, env = "EFFIGY_MAX_UPLOAD_BYTES", default_value_t = Limits::default().upload_bytes)]
    max_upload_bytes: u64,
}

pub fn run(args: Args) -> Result<()> {
    start_log();
    tokio::runtime::Builder::new_multi_thread().enable_all().build()?.block_on(serve(args))
}

async fn serve(args: Args) -> Result<()> {
    let store = open_store(&args.service.data_dir())?;
    let Some(_lock) = store.lock_server()? else {
        bail!("another server uses the data folder {}", store.root().display());
    };
    let env = Env::system();
    let queue = open_queue(&store, &env, args.service.policy()).await?;
    clean(&store, queue.as_ref()).await?;
    let reaper = tokio::spawn(Reaper { queue: queue.clone(), store: store.clone() }.run());

    let supervisor = match args.workers {
        0 => None,
        _ => Some(Supervisor::new(worker_command(&store, &args.service)?)),
    };
    let renderer: Arc<dyn Renderer> = match &supervisor {
        Some(supervisor) => supervisor.clone(),
        None => Arc::new(NoRenderer),
    };
    let supervision = supervisor.clone().map(|supervisor| tokio::spawn(supervisor.run()));

    let listener = tokio::net::TcpListener::bind(args.listen).await;
    let listener = listener.with_context(|| format!("listening on {}", args.listen))?;
    let address = listener.local_addr()?;
    tracing::info!(data = %store.root().display(), "the server is ready");
    println!("listening on http://{address}");

    let inspector = Arc::new(ClipInspector { store: store.clone() });
    let limits = Limits { upload_bytes: args.max_upload_bytes };
    let app = App::new(queue.clone(), store, renderer, inspector, env, limits);
    let end = async move {
        asked_to_end().await;
        tracing::info!("the server ends");
        if let Some(supervisor) = supervisor {
            supervisor.stop();
        }
    };
    effigy::http::serve(listener, app, end).await?;
    if let Some(supervision) = supervision {
        supervision.await?;
    }
    reaper.abort();
    queue.close().await;
    Ok(())
}

/// Removes what a killed server left half-written.
async fn clean(store: &Store, queue: &dyn Queue) -> Result<()> {
    let mut known = HashSet::new();
    for job in store.job_folders()? {
        if queue.get(job).await?.is_some() {
            known.insert(job);
        }
    }
    store.clean(&known).context("cleaning the data folder")
}

/// This very program, as a worker on the same data.
fn worker_command(store: &Store, service: &ServiceArgs) -> Result<SupervisorSettings> {
    let program = std::env::current_exe().context("finding this program for its worker")?;
    let text = |path: &Path| path.to_str().map(str::to_string).context("the data folder's name is no UTF-8");
    let mut arguments = vec!["worker".to_string(), "--renders-on-stdio".into(), "--data-dir".into()];
    arguments.push(text(store.root())?);
    arguments.extend(["--stall-secs".to_string(), service.stall_secs.to_string()]);
    if let Some(days) = service.retain_days {
        arguments.extend(["--retain-days".to_string(), days.to_string()]);
    }
    Ok(SupervisorSettings::new(program, arguments, store.renders()))
}
