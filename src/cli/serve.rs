//! `effigy serve`: the API and, as a child process, its worker.

use std::collections::HashSet;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use effigy::config::Config;
use effigy::http::{Access, App, ClipInspector, Limits, Openness};
use effigy::jobs::keys::Keys;
use effigy::jobs::render::{NoRenderer, Renderer};
use effigy::jobs::sqlite::SqliteQueue;
use effigy::jobs::{Env, Queue, QueueError, State};
use effigy::storage::Store;
use effigy::webhooks::{Courier, Sender, system_lookup};
use effigy::worker::{Reaper, Supervisor, SupervisorSettings};

use super::service::{self, KeysFound, asked_to_end, is_queues, open_queue, open_with_reserve, policy, start_log};
use super::settings::{InForce, ServerFlags};

#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    settings: ServerFlags,
}

pub fn run(args: Args) -> Result<()> {
    let in_force = args.settings.resolve()?;
    let _spans = start_log(&in_force, "server")?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let served = runtime.block_on(serve(in_force));
    // Nobody waits any more for the clip that is being looked at; what it leaves, the next start removes.
    runtime.shutdown_timeout(Duration::from_secs(1));
    served
}

async fn serve(in_force: InForce) -> Result<()> {
    let config = &in_force.config;
    let store = open_with_reserve(config)?;
    let Some(_lock) = store.lock_server().context("serve.lock in the data folder")? else {
        bail!("another server uses the data folder {}", store.root().display());
    };
    let env = Env::system();
    let is_full = |error: &anyhow::Error| is_queues(error, QueueError::is_disk_full);
    let queue = store.despite_full_disk(is_full, || begin(&store, &env, config)).await?;
    store.load_ballast().context("keeping a little room for deletions")?;
    let reaper = tokio::spawn(Reaper { queue: queue.clone(), store: store.clone() }.run());

    let supervisor = match config.workers.0 {
        0 => None,
        _ => Some(Supervisor::new(worker_command(&store, &in_force)?)),
    };
    let renderer: Arc<dyn Renderer> = match &supervisor {
        Some(supervisor) => supervisor.clone(),
        None => Arc::new(NoRenderer),
    };
    let supervision = supervisor.clone().map(|supervisor| tokio::spawn(supervisor.run()));

    if store.body_names()?.is_empty() {
        tracing::warn!("there is no body, so every job is refused: import one (effigy doctor tells how)");
    }
    let access = access(config, &queue).await?;
    let asked = asked_to_end();
    let listener = tokio::net::TcpListener::bind(config.listen).await;
    let listener = listener.with_context(|| format!("listening on {}", config.listen))?;
    let address = listener.local_addr()?;
    tracing::info!(data = %store.root().display(), "the server is ready");
    println!("listening on http://{address}");

    let inspector = Arc::new(ClipInspector { store: store.clone() });
    let limits = Limits {
        upload_bytes: config.max_upload_bytes.0,
        open_uploads: config.max_open_uploads as usize,
        open_upload_bytes: config.max_open_upload_bytes.0,
        upload_ttl: config.upload_ttl_secs.duration(),
        ..Limits::default()
    };
    let app = App::new(queue.clone(), store, renderer, inspector, env.clone(), limits)
        .with_access(access)
        .with_webhooks(queue.clone(), config.webhooks_to_private);
    let courier = courier(&queue, env, config).map(|courier| tokio::spawn(courier.run()));
    let end = async move {
        asked.await;
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
    if let Some(courier) = courier {
        courier.abort();
    }
    queue.close().await;
    Ok(())
}

/// Who may ask what, and the secret that signs links.
async fn access(config: &Config, queue: &Arc<SqliteQueue>) -> Result<Access> {
    let openness = openness(config, queue.as_ref()).await?;
    let mut fresh = [0; 32];
    getrandom::fill(&mut fresh).context("the system's randomness")?;
    let secret = queue.secret("links", fresh).await?;
    Ok(Access::new(openness, queue.clone(), config.cors_origins.0.clone(), secret))
}

/// None on a machine that trusts nobody: all else works without, and messages wait in the database.
fn courier(queue: &Arc<SqliteQueue>, env: Env, config: &Config) -> Option<Courier> {
    match Sender::new(system_lookup(), config.webhooks_to_private) {
        Ok(sender) => Some(Courier { webhooks: queue.clone(), sender, env }),
        Err(error) => {
            let error = format!("{error:#}");
            tracing::error!(error, "webhooks wait for a start with CA certificates (ca-certificates)");
            None
        }
    }
}

/// Opens the database and brings it and the files to what holds now.
async fn begin(store: &Arc<Store>, env: &Env, config: &Config) -> Result<Arc<SqliteQueue>> {
    let queue = open_queue(store, env, policy(config)).await?;
    match queue.apply_retention().await? {
        0 => {}
        jobs => tracing::info!(jobs, "retain_days has changed: what has ended is kept by it"),
    }
    clean(store, queue.as_ref()).await?;
    Ok(queue)
}

/// Removes what a killed server left half-written, and files of expired jobs that are still there.
async fn clean(store: &Store, queue: &dyn Queue) -> Result<()> {
    let mut known = HashSet::new();
    for job in store.job_folders()? {
        if queue.get(job).await?.is_some_and(|job| job.state != State::Expired) {
            known.insert(job);
        }
    }
    store.clean(&known).context("cleaning the data folder")
}

/// Whom the server listens to, and a word where that is everybody or nobody.
async fn openness(config: &Config, keys: &dyn Keys) -> Result<Openness> {
    let found = KeysFound::of(keys).await?;
    let Some(openness) = service::openness(config, found) else {
        bail!(
            "others can reach {} and there is no key: make one (effigy keys create NAME), listen on 127.0.0.1, or set \
             auth to \"open\"",
            config.listen
        );
    };
    match openness {
        Openness::Open => tracing::warn!("whoever reaches {} may do everything: auth = \"open\"", config.listen),
        Openness::Keys if !found.living => {
            tracing::warn!("no key opens anything, so nobody can call (effigy keys create NAME)");
        }
        Openness::Keys | Openness::Local => {}
    }
    Ok(openness)
}

/// This very program, as a worker on the same data.
fn worker_command(store: &Store, in_force: &InForce) -> Result<SupervisorSettings> {
    let program = std::env::current_exe().context("finding this program for its worker")?;
    let mut arguments = vec!["worker".to_string(), "--renders-on-stdio".into()];
    arguments.extend(in_force.worker_flags(store.root().to_str().context("the data folder's name is no UTF-8")?));
    let settings = SupervisorSettings::new(program, arguments, store.renders());
    // A fit that hangs ends by itself after this time; what has only been asked for may wait as long again as a render.
    let silence = in_force.config.stall_secs.duration() + settings.timeout;
    Ok(SupervisorSettings { silence, ..settings })
}
