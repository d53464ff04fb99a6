//! When an upload that nobody goes on with is removed.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use uuid::Uuid;

use crate::http::App;
use crate::http::error::ApiError;

/// How often uploads are looked through for those that nobody goes on with.
const SWEEP: Duration = Duration::from_secs(60);

/// `Upload-Expires` of an upload whose last bytes came at this time.
pub(super) fn expires(app: &App, touched: SystemTime) -> String {
    httpdate::fmt_http_date(touched + app.limits.upload_ttl)
}

pub(super) fn wall_clock(app: &App) -> SystemTime {
    UNIX_EPOCH + Duration::from_millis(app.env.now().0.max(0) as u64)
}

/// Removes uploads for which nothing came for so long that they have expired. For ever.
pub(in crate::http) async fn sweep(app: App) {
    loop {
        app.expire_uploads().await;
        tokio::time::sleep(SWEEP.min(app.limits.upload_ttl)).await;
    }
}

impl App {
    /// One look through the uploads.
    pub async fn expire_uploads(&self) {
        if let Some(leap_ms) = self.leaps.since_last_look(&self.env) {
            let (store, now) = (self.store.clone(), wall_clock(self));
            let moved = tokio::task::spawn_blocking(move || store.move_resumables(leap_ms, now)).await;
            if let Err(error) = moved.unwrap_or_else(|panic| Err(panic.into())) {
                tracing::warn!(%error, "an upload may expire at another time than was told");
            }
        }
        let store = self.store.clone();
        match tokio::task::spawn_blocking(move || store.resumable_ids()).await {
            Ok(Ok(ids)) => {
                for id in ids {
                    if let Err(error) = expire(self, id).await {
                        tracing::warn!(upload = %id, %error, "an expired upload stays");
                    }
                }
            }
            Ok(Err(error)) => tracing::warn!(%error, "the uploads cannot be looked through"),
            Err(error) => tracing::error!(%error, "looking through the uploads panicked"),
        }
    }
}

async fn expire(app: &App, id: Uuid) -> Result<(), ApiError> {
    let now = wall_clock(app);
    // An upload whose last bytes are of the future is young: the clock was set back.
    let is_old = || match app.store.resumable_touched(id) {
        Ok(touched) => now.duration_since(touched).is_ok_and(|age| age > app.limits.upload_ttl),
        Err(_) => false,
    };
    // The look itself cuts nobody off: whoever still sends has touched it.
    if !is_old() {
        return Ok(());
    }
    let _turn = app.uploads.take(id).await?;
    if is_old() {
        let store = app.store.clone();
        tokio::task::spawn_blocking(move || store.remove_resumable(id)).await.map_err(ApiError::internal)??;
        tracing::info!(upload = %id, "an upload has expired");
    }
    Ok(())
}
