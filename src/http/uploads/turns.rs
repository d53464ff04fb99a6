//! One request at a time for each upload; a newer one makes an older give way. A client whose connection broke comes back
//! before the server has noticed, and the bytes of the old connection must not come between.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::sync::{OwnedMutexGuard, watch};
use uuid::Uuid;

use crate::http::error::ApiError;

/// An older request gives way between two chunks, so this is long.
const WAIT: Duration = Duration::from_secs(10);

#[derive(Default)]
pub struct Turns(Mutex<HashMap<Uuid, Arc<Place>>>);

#[derive(Default)]
struct Place {
    taken: Arc<tokio::sync::Mutex<()>>,
    /// Grows with each request.
    arrivals: watch::Sender<u64>,
}

/// The right to work on an upload.
pub struct Turn {
    arrivals: watch::Receiver<u64>,
    _place: Arc<Place>,
    _taken: OwnedMutexGuard<()>,
}

impl Turns {
    /// Waits until the requests before have given way.
    pub async fn take(&self, id: Uuid) -> Result<Turn, ApiError> {
        let place = {
            let mut places = self.0.lock().unwrap();
            // Whoever works or waits has a share in the place.
            places.retain(|_, place| Arc::strong_count(place) > 1);
            places.entry(id).or_default().clone()
        };
        place.arrivals.send_modify(|count| *count += 1);
        let mut arrivals = place.arrivals.subscribe();
        arrivals.mark_unchanged();
        let taken = tokio::time::timeout(WAIT, place.taken.clone().lock_owned()).await;
        let taken = taken.map_err(|_| ApiError::Busy("another request works on this upload".into()))?;
        Ok(Turn { arrivals, _place: place, _taken: taken })
    }
}

impl Turn {
    /// Until a newer request wants the upload.
    pub async fn wanted(&mut self) {
        // The place, and with it the sender, lives as long as this.
        let _ = self.arrivals.changed().await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn an_older_request_gives_way_to_a_newer() {
        let turns = Arc::new(Turns::default());
        let id = Uuid::new_v4();
        let mut first = turns.take(id).await.unwrap();
        let other = turns.clone();
        let second = tokio::spawn(async move { other.take(id).await.map(|_| ()) });
        first.wanted().await;
        assert!(!second.is_finished());
        drop(first);
        second.await.unwrap().unwrap();
        // Another upload has its own place.
        let _one = turns.take(id).await.unwrap();
        let _two = turns.take(Uuid::new_v4()).await.unwrap();
        assert_eq!(turns.0.lock().unwrap().len(), 2);
    }
}
