//! The life of the server.

use std::future::Future;
use std::io;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::server::graceful::GracefulShutdown;
use hyper_util::service::TowerToHyperService;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::App;
use super::app::Feed;
use super::patience::Patient;

/// How long open answers may take after the wish to stop. Uploads that take longer are cut; their clients see it.
const DRAIN: Duration = Duration::from_secs(10);
/// How often the database is asked whether a worker, another process, wrote an event.
const FEED: Duration = Duration::from_millis(250);
/// From the beginning of a connection, or the end of an answer, to the end of the next request's head. Who has sent
/// nothing by then is cut off.
const HEAD: Duration = Duration::from_secs(15);
/// Connections at a time; more wait to be accepted until some end.
const CONNECTIONS: usize = 4096;

/// Serves until `stop` is done, then lets open requests finish.
pub async fn serve(listener: TcpListener, app: App, stop: impl Future<Output = ()> + Send + 'static) -> io::Result<()> {
    raise_open_files();
    let feed = tokio::spawn(watch_events(app.clone()));
    let sweep = tokio::spawn(super::uploads::sweep(app.clone()));
    let upkeep = tokio::spawn(super::metrics::upkeep());
    let (closing, patience) = (app.feed.clone(), app.limits.patience);
    let service = TowerToHyperService::new(super::router(app));
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(HEAD);
    let (connections, slots) = (GracefulShutdown::new(), Arc::new(Semaphore::new(CONNECTIONS)));
    let mut stop = pin!(stop);
    loop {
        let (stream, slot) = tokio::select! {
            accepted = accept(&listener, &slots) => accepted,
            () = &mut stop => break,
        };
        let stream = TokioIo::new(Patient::new(stream, patience));
        let connection = connections.watch(http.serve_connection(stream, service.clone()));
        tokio::spawn(async move {
            let _slot = slot;
            // A client that goes away in the middle is its own affair.
            if let Err(error) = connection.await {
                tracing::debug!(%error, "a connection ended");
            }
        });
    }
    drop(listener);
    closing.send_modify(|feed| feed.closing = true);
    if tokio::time::timeout(DRAIN, connections.shutdown()).await.is_err() {
        tracing::warn!("requests that were still open are cut");
    }
    feed.abort();
    sweep.abort();
    upkeep.abort();
    Ok(())
}

async fn accept(listener: &TcpListener, slots: &Arc<Semaphore>) -> (TcpStream, Option<OwnedSemaphorePermit>) {
    // The semaphore is never closed.
    let slot = slots.clone().acquire_owned().await.ok();
    loop {
        match listener.accept().await {
            Ok((stream, _)) => {
                // Small answers must not wait for the acknowledgement of the last.
                let _ = stream.set_nodelay(true);
                return (stream, slot);
            }
            Err(error) => {
                // No files left, or a client that was gone before it was met.
                tracing::debug!(%error, "no connection");
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
        }
    }
}

/// A connection is a file, and many systems allow a process but 1024 unless it asks.
fn raise_open_files() {
    #[cfg(unix)]
    // SAFETY: both calls only read and write the given struct of numbers.
    unsafe {
        let mut limit = libc::rlimit { rlim_cur: 0, rlim_max: 0 };
        if libc::getrlimit(libc::RLIMIT_NOFILE, &mut limit) == 0 && limit.rlim_cur < limit.rlim_max {
            limit.rlim_cur = limit.rlim_max.min(65_536).max(limit.rlim_cur);
            libc::setrlimit(libc::RLIMIT_NOFILE, &limit);
        }
    }
}

/// Wakes the event streams when there is something new, with one question for all of them.
async fn watch_events(app: App) {
    loop {
        // Without readers there is nobody to tell.
        if app.feed.receiver_count() > 0 {
            match app.queue.last_event().await {
                Ok(newest) => {
                    app.feed.send_if_modified(|feed: &mut Feed| std::mem::replace(&mut feed.newest, newest) != newest);
                }
                Err(error) => tracing::warn!(%error, "the event feed missed a look"),
            }
        }
        tokio::time::sleep(FEED).await;
    }
}
