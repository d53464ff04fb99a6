//! `effigy worker`: claims and runs jobs of a data folder.

use std::thread;

use anyhow::{Result, bail};
use effigy::config::Config;
use effigy::jobs::Env;
use effigy::worker::{self, DeviceEngine, DeviceThread, Owner, Reaper, Worker, channel};
use tokio::sync::watch;

use super::service::{asked_to_end, open_queue, open_with_reserve, policy, start_log};
use super::settings::CommonFlags;

#[derive(clap::Args)]
pub struct Args {
    #[command(flatten)]
    settings: CommonFlags,
    /// Serve a server's renders on standard input and output, and end with the input.
    #[arg(long, hide = true)]
    renders_on_stdio: bool,
}

/// Added to the niceness of a server's child, so that answers come before fits.
#[cfg(unix)]
const NICENESS: libc::c_int = 10;

pub fn run(args: Args) -> Result<()> {
    if args.renders_on_stdio {
        lower_priority();
    }
    let in_force = args.settings.resolve()?;
    let _spans = start_log(&in_force, "worker")?;
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
    runtime.block_on(work(&in_force.config, args.renders_on_stdio))
}

async fn work(config: &Config, renders_on_stdio: bool) -> Result<()> {
    let store = open_with_reserve(config)?;
    let env = Env::system();
    let queue = open_queue(&store, &env, policy(config)).await?;
    let device = DeviceThread::start(DeviceEngine::default())?;
    let (shutdown, stopped) = watch::channel(false);
    if renders_on_stdio {
        tokio::spawn(channel::tell(device.trouble()));
        let (device, shutdown) = (device.clone(), shutdown.clone());
        thread::Builder::new().name("channel".into()).spawn(move || {
            if let Err(error) = channel::serve(std::io::stdin().lock(), &device) {
                tracing::error!(%error, "the server cannot be heard");
            }
            // A server that was killed says nothing else.
            shutdown.send_replace(true);
        })?;
    } else {
        // A server reaps for its child.
        tokio::spawn(Reaper { queue: queue.clone(), store: store.clone() }.run());
    }
    let asked = asked_to_end();
    tokio::spawn(async move {
        asked.await;
        shutdown.send_replace(true);
    });
    let owner = Owner::new(&store.workers(), env.new_id())?;
    let stall = config.stall_secs.duration();
    let settings = worker::WorkerSettings { stall, ..worker::WorkerSettings::default() };
    let overdue = overdue(stopped.clone());
    tokio::select! {
        ended = Worker { queue: queue.clone(), store, device, owner, settings }.run(stopped) => {
            if let Err(hung) = ended {
                tracing::error!("{hung}; this process ends");
                end_at_once();
            }
        }
        () = overdue => bail!("the fit did not stop in time; its job goes on elsewhere from the last checkpoint"),
    }
    queue.close().await;
    Ok(())
}

/// Comes some time after the wish to end. A fit that hangs would otherwise keep its lease and the device for ever.
async fn overdue(mut stopped: watch::Receiver<bool>) {
    if stopped.wait_for(|stopped| *stopped).await.is_ok() {
        tokio::time::sleep(worker::STOP_GRACE).await;
    }
}

/// Without the exit handlers of drivers, which would wait for the thread that hangs.
fn end_at_once() -> ! {
    #[cfg(unix)]
    // SAFETY: ends the process; nothing runs after it.
    unsafe {
        libc::_exit(1)
    }
    #[cfg(not(unix))]
    std::process::exit(1)
}

fn lower_priority() {
    #[cfg(unix)]
    // SAFETY: takes numbers, touches no memory of ours. Threads that are started later inherit it.
    let refused = unsafe { libc::setpriority(libc::PRIO_PROCESS, 0, NICENESS) } != 0;
    #[cfg(unix)]
    if refused {
        eprintln!("effigy worker: the priority could not be lowered: {}", std::io::Error::last_os_error());
    }
}
