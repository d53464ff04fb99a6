//! The life of the server.

use std::future::Future;
use std::io;
use std::time::Duration;

use tokio::net::TcpListener;

use super::App;
use super::app::Feed;

/// How long open answers may take after the wish to stop. Uploads that take longer are cut; their clients see it.
const DRAIN: Duration = Duration::from_secs(10);
/// How often the database is asked whether a worker, another process, wrote an event.
const FEED: Duration = Duration::from_millis(250);

/// Serves until `stop` is done, then lets open requests finish.
pub async fn serve(listener: TcpListener, app: App, stop: impl Future<Output = ()> + Send + 'static) -> io::Result<()> {
    let feed = tokio::spawn(watch_events(app.clone()));
    let closing = app.feed.clone();
    let (stopping, stopped) = tokio::sync::oneshot::channel();
    let graceful = async move {
        stop.await;
        closing.send_modify(|feed| feed.closing = true);
        // The receiver is gone only when the server has ended already.
        let _ = stopping.send(());
    };
    let server = axum::serve(listener, super::router(app)).with_graceful_shutdown(graceful).into_future();
    let drained = async {
        if stopped.await.is_ok() {
            tokio::time::sleep(DRAIN).await;
        } else {
            std::future::pending::<()>().await;
        }
    };
    let served = tokio::select! {
        served = server => served,
        () = drained => {
            tracing::warn!("requests that were still open are cut");
            Ok(())
        }
    };
    feed.abort();
    served
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
