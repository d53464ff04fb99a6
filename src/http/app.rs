//! What the handlers share.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::sync::{Semaphore, watch};

use super::access::Access;
use super::pace::Pace;
use super::uploads::Turns;
use crate::capture::CaptureInputs;
use crate::jobs::render::Renderer;
use crate::jobs::webhooks::Webhooks;
use crate::jobs::{Clip, Env, JobOptions, Leaps, Queue};
use crate::storage::Store;

/// Why an upload is not accepted.
#[derive(Debug, thiserror::Error)]
pub enum InspectError {
    /// The sender's to mend.
    #[error("{message}")]
    Bad { part: String, frame: Option<u32>, message: String, expected: String },
    #[error("the upload could not be inspected")]
    Internal(#[source] anyhow::Error),
}

/// Looks through an upload before its job is accepted. Blocks.
pub trait Inspector: Send + Sync + 'static {
    fn inspect(&self, files: &CaptureInputs, options: &JobOptions) -> Result<Clip, InspectError>;
}

/// Sizes beyond which a request is refused.
#[derive(Clone, Debug)]
pub struct Limits {
    /// Of all parts of an upload together.
    pub upload_bytes: u64,
    /// Resumable uploads that no job has used yet: their number, and their bytes together.
    pub open_uploads: usize,
    pub open_upload_bytes: u64,
    /// Such an upload is removed when nothing has come for so long.
    pub upload_ttl: Duration,
    /// The slowest that a body may come.
    pub pace: Pace,
    /// A client that takes nothing of its answer for so long is cut off.
    pub patience: Duration,
}

/// One request at a time for each client's key.
#[derive(Default)]
pub(super) struct KeyLocks(Mutex<HashMap<String, Arc<tokio::sync::Mutex<()>>>>);

impl KeyLocks {
    pub async fn lock(&self, key: &str) -> tokio::sync::OwnedMutexGuard<()> {
        let lock = {
            let mut locks = self.0.lock().unwrap();
            // Whoever holds or awaits a lock has a share in it.
            locks.retain(|_, lock| Arc::strong_count(lock) > 1);
            locks.entry(key.into()).or_default().clone()
        };
        lock.lock_owned().await
    }
}

impl Default for Limits {
    fn default() -> Self {
        Limits {
            upload_bytes: 4 << 30,
            open_uploads: 100,
            open_upload_bytes: 32 << 30,
            upload_ttl: Duration::from_secs(24 * 3600),
            pace: Pace::default(),
            patience: Duration::from_secs(60),
        }
    }
}

/// Uploads that are inspected at the same time: each runs a decoder.
const INSPECTIONS: usize = 2;

/// State of the router.
#[derive(Clone)]
pub struct App {
    pub queue: Arc<dyn Queue>,
    pub store: Arc<Store>,
    pub renderer: Arc<dyn Renderer>,
    pub inspector: Arc<dyn Inspector>,
    pub env: Env,
    pub limits: Limits,
    pub access: Arc<Access>,
    /// Where webhooks are kept, and whether they may have private addresses.
    pub(super) webhooks: Option<(Arc<dyn Webhooks>, bool)>,
    pub(super) inspections: Arc<Semaphore>,
    pub(super) keys: Arc<KeyLocks>,
    pub(super) uploads: Arc<Turns>,
    /// Of the wall clock, for the age of uploads.
    pub(super) leaps: Arc<Leaps>,
    /// Id of the newest event, and the end of the server: what event streams wait for.
    pub(super) feed: watch::Sender<Feed>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Feed {
    pub newest: i64,
    pub closing: bool,
}

impl App {
    pub fn new(
        queue: Arc<dyn Queue>,
        store: Arc<Store>,
        renderer: Arc<dyn Renderer>,
        inspector: Arc<dyn Inspector>,
        env: Env,
        limits: Limits,
    ) -> App {
        let inspections = Arc::new(Semaphore::new(INSPECTIONS));
        let (access, webhooks) = (Arc::new(Access::open()), None);
        App {
            queue,
            store,
            renderer,
            inspector,
            env,
            limits,
            access,
            webhooks,
            inspections,
            keys: Arc::default(),
            uploads: Arc::default(),
            leaps: Arc::default(),
            feed: watch::Sender::default(),
        }
    }

    /// Under these rules instead of none.
    pub fn with_access(self, access: Access) -> App {
        App { access: Arc::new(access), ..self }
    }

    /// With webhooks; `private` allows plain HTTP and addresses of one's own network.
    pub fn with_webhooks(self, webhooks: Arc<dyn Webhooks>, private: bool) -> App {
        App { webhooks: Some((webhooks, private)), ..self }
    }
}
