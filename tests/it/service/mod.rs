//! The service over HTTP: each request goes through the whole router, onto a real queue and store.

mod access;
mod avatars;
mod backup;
mod events;
mod faults;
mod hostile;
mod jobs;
mod limits;
mod load;
mod openapi;
mod page;
mod previews;
mod process;
mod rehearsal;
mod renders;
mod resume;
mod torture;
mod tus;
mod uploads;
mod webhooks;

use std::collections::BTreeMap;
use std::io::{Cursor, Write};
use std::path::PathBuf;
use std::sync::{Arc, Mutex};

use axum::Router;
use axum::body::{Body, to_bytes};
use axum::http::{HeaderMap, Method, Request, StatusCode};
use effigy::http::{App, ClipInspector, Limits};
use effigy::jobs::render::{RenderError, RenderRequest, Renderer};
use effigy::jobs::sqlite::SqliteQueue;
use effigy::jobs::{AvatarFile, Clip, Env, JobOptions, Lease, NewAvatar, NewJob, Part, Policy, Queue};
use effigy::storage::{Published, Store};
use futures_util::future::BoxFuture;
use serde_json::{Value, json};
use tempfile::TempPath;
use tower::ServiceExt;
use uuid::Uuid;

/// Clients of a server on this machine: a proxy of the machine's is not asked.
fn client_builder() -> reqwest::ClientBuilder {
    effigy::webhooks::install_cryptography();
    reqwest::Client::builder().no_proxy()
}

fn client() -> reqwest::Client {
    client_builder().build().unwrap()
}

fn blocking_client_builder() -> reqwest::blocking::ClientBuilder {
    effigy::webhooks::install_cryptography();
    reqwest::blocking::Client::builder().no_proxy()
}

fn blocking_client() -> reqwest::blocking::Client {
    blocking_client_builder().build().unwrap()
}

/// A service without a worker: the tests play its part on the queue.
struct Bench {
    app: App,
    router: Router,
    queue: Arc<dyn Queue>,
    keys: Arc<SqliteQueue>,
    store: Arc<Store>,
    env: Env,
    draws: Arc<Draws>,
    _folder: Option<tempfile::TempDir>,
}

/// Answers renders with a fixed text and remembers what was asked.
struct Draws {
    folder: PathBuf,
    asked: Mutex<Vec<RenderRequest>>,
    answer: Mutex<Result<&'static [u8], RenderError>>,
    /// Happens while the next request waits.
    meanwhile: Mutex<Option<BoxFuture<'static, ()>>>,
}

impl Renderer for Draws {
    fn render(&self, request: RenderRequest) -> BoxFuture<'_, Result<TempPath, RenderError>> {
        self.asked.lock().unwrap().push(request);
        let answer = self.answer.lock().unwrap().clone();
        let meanwhile = self.meanwhile.lock().unwrap().take();
        Box::pin(async move {
            if let Some(meanwhile) = meanwhile {
                meanwhile.await;
            }
            let path = self.folder.join(Uuid::new_v4().to_string());
            std::fs::write(&path, answer?).unwrap();
            Ok(TempPath::try_from_path(path).unwrap())
        })
    }

    fn trouble(&self) -> Option<String> {
        None
    }
}

struct Reply {
    status: StatusCode,
    headers: HeaderMap,
    body: Vec<u8>,
}

impl Reply {
    fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap_or_else(|e| panic!("{e}: {}", String::from_utf8_lossy(&self.body)))
    }

    fn header(&self, name: &str) -> &str {
        self.headers.get(name).unwrap_or_else(|| panic!("no {name}")).to_str().unwrap()
    }

    /// The problem document, which must be one.
    #[track_caller]
    fn problem(&self, status: u16) -> Value {
        let problem = self.json();
        assert_eq!(self.status.as_u16(), status, "{problem}");
        assert_eq!(self.header("content-type"), "application/problem+json");
        assert!(problem["type"].as_str().unwrap().starts_with("urn:effigy:problem:"), "{problem}");
        assert_eq!(problem["status"], status);
        assert!(!problem["title"].as_str().unwrap().is_empty() && !problem["detail"].as_str().unwrap().is_empty());
        problem
    }
}

impl Bench {
    async fn new() -> Bench {
        Self::with_limits(Limits::default()).await
    }

    async fn with_limits(limits: Limits) -> Bench {
        Self::with(limits, Policy::default(), 0, Env::system()).await
    }

    async fn with(limits: Limits, policy: Policy, reserve_bytes: u64, env: Env) -> Bench {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().to_path_buf();
        Self::at(root, Some(folder), limits, policy, reserve_bytes, env).await
    }

    /// Beside others who work on a folder.
    async fn on(root: PathBuf) -> Bench {
        let policy = Policy { max_queued: u64::MAX, ..Policy::default() };
        Self::at(root, None, Limits::default(), policy, 0, Env::system()).await
    }

    async fn at(
        root: PathBuf,
        folder: Option<tempfile::TempDir>,
        limits: Limits,
        policy: Policy,
        reserve_bytes: u64,
        env: Env,
    ) -> Bench {
        effigy::webhooks::install_cryptography();
        let store = Arc::new(Store::open(&root).unwrap().with_reserve(reserve_bytes));
        // The API only asks whether the body is there.
        std::fs::write(store.bodies().join("default.body.npz"), b"").unwrap();
        let policy = Policy { backoff: std::time::Duration::from_millis(10), ..policy };
        let keys = Arc::new(SqliteQueue::open(&store.database(), env.clone(), policy).await.unwrap());
        let queue: Arc<dyn Queue> = keys.clone();
        let (asked, answer) = (Mutex::default(), Mutex::new(Ok(&b"drawn"[..])));
        let draws = Arc::new(Draws { folder: store.renders(), asked, answer, meanwhile: Mutex::default() });
        let inspector = Arc::new(ClipInspector { store: store.clone() });
        let app = App::new(queue.clone(), store.clone(), draws.clone(), inspector, env.clone(), limits);
        let router = effigy::http::router(app.clone());
        Bench { app, router, queue, keys, store, env, draws, _folder: folder }
    }

    async fn send(&self, request: Request<Body>) -> Reply {
        let (parts, body) = self.router.clone().oneshot(request).await.unwrap().into_parts();
        let body = to_bytes(body, usize::MAX).await.unwrap().to_vec();
        Reply { status: parts.status, headers: parts.headers, body }
    }

    async fn call(&self, method: Method, path: &str, headers: &[(&str, &str)], body: impl Into<Body>) -> Reply {
        let mut request = Request::builder().method(method).uri(path);
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        self.send(request.body(body.into()).unwrap()).await
    }

    async fn get(&self, path: &str) -> Reply {
        self.call(Method::GET, path, &[], Body::empty()).await
    }

    async fn post(&self, path: &str) -> Reply {
        self.call(Method::POST, path, &[], Body::empty()).await
    }

    async fn post_json(&self, path: &str, body: &Value) -> Reply {
        self.call(Method::POST, path, &[("content-type", "application/json")], body.to_string()).await
    }

    async fn upload(&self, form: &Form) -> Reply {
        self.call(Method::POST, "/v1/jobs", &[("content-type", Form::TYPE)], form.body()).await
    }

    /// Puts a job into the queue beside the API.
    async fn add_job(&self) -> Uuid {
        self.add_job_of(None).await
    }

    async fn add_job_of(&self, key: Option<Uuid>) -> Uuid {
        let id = self.env.new_id();
        std::fs::create_dir_all(self.store.inputs(id)).unwrap();
        let inputs = BTreeMap::from([("video".to_string(), Part { bytes: 4 })]);
        let clip = Clip { frames: 5, width: 64, height: 48, fps: 30.0, warnings: Vec::new() };
        let new = NewJob { id, key, options: JobOptions::default(), inputs, clip, remember: None };
        self.queue.insert(new).await.unwrap().queued().unwrap();
        id
    }

    async fn claim(&self) -> Lease {
        self.queue.claim("tests").await.unwrap().unwrap().0
    }

    /// Makes an avatar with these files.
    async fn publish(&self, files: &[(&str, &[u8])]) -> Uuid {
        self.publish_of(None, files).await
    }

    async fn publish_of(&self, key: Option<Uuid>, files: &[(&str, &[u8])]) -> Uuid {
        let id = self.add_job_of(key).await;
        let lease = self.claim().await;
        self.end_with(&lease, files).await;
        id
    }

    /// Ends a claimed job with an avatar of these files.
    async fn end_with(&self, lease: &Lease, files: &[(&str, &[u8])]) {
        let folder = self.store.results(lease.job, lease.epoch);
        std::fs::create_dir_all(&folder).unwrap();
        for (name, content) in files {
            std::fs::write(folder.join(name), content).unwrap();
        }
        let sealed = Published::seal(&folder).unwrap();
        let sealed = sealed.into_iter().map(|f| AvatarFile { name: f.name, bytes: f.bytes, sha256: f.sha256 });
        let camera = json!({ "width": 64, "height": 48, "fx": 60.0, "fy": 60.0, "cx": 32.0, "cy": 24.0 });
        let avatar = NewAvatar {
            body: "default".into(),
            frames: 5,
            camera: serde_json::from_value(camera).unwrap(),
            metrics: json!({ "iou": 0.95 }),
            files: sealed.collect(),
        };
        self.queue.succeed(lease, avatar).await.unwrap();
    }

    /// The database itself is whole.
    async fn check_integrity(&self) {
        let options = sqlx::sqlite::SqliteConnectOptions::new().filename(self.store.database());
        let pool = sqlx::SqlitePool::connect_with(options).await.unwrap();
        let said: String = sqlx::query_scalar("PRAGMA integrity_check").fetch_one(&pool).await.unwrap();
        assert_eq!(said, "ok");
        pool.close().await;
    }

    /// Nothing of a refused upload is left.
    fn assert_empty(&self) {
        for folder in ["tmp", "jobs"] {
            let left: Vec<_> = std::fs::read_dir(self.store.root().join(folder)).unwrap().collect();
            assert!(left.is_empty(), "{folder}: {left:?}");
        }
    }
}

/// A multipart body.
#[derive(Clone)]
struct Form(Vec<(String, Vec<u8>)>);

const FRAMES: usize = 4;
const WIDTH: u32 = 32;
const HEIGHT: u32 = 48;

impl Form {
    const TYPE: &str = "multipart/form-data; boundary=effigy-test-boundary";

    /// A clip of a box, as zips of pictures: it needs no encoder.
    fn clip() -> Form {
        Form(vec![
            ("video".into(), zip_of((0..FRAMES).map(|i| picture(i, 3)))),
            ("masks".into(), zip_of((0..FRAMES).map(|i| picture(i, 1)))),
            ("keypoints".into(), keypoints(FRAMES).to_string().into_bytes()),
        ])
    }

    fn with(mut self, part: &str, content: impl Into<Vec<u8>>) -> Form {
        self.0.retain(|(name, _)| name != part);
        self.0.push((part.into(), content.into()));
        self
    }

    fn without(mut self, part: &str) -> Form {
        self.0.retain(|(name, _)| name != part);
        self
    }

    fn body(&self) -> Vec<u8> {
        let mut body = Vec::new();
        for (name, content) in &self.0 {
            let head = format!("--effigy-test-boundary\r\ncontent-disposition: form-data; name=\"{name}\"\r\n\r\n");
            body.extend_from_slice(head.as_bytes());
            body.extend_from_slice(content);
            body.extend_from_slice(b"\r\n");
        }
        body.extend_from_slice(b"--effigy-test-boundary--\r\n");
        body
    }
}

fn is_inside(i: usize, x: u32, y: u32) -> bool {
    (8 + i as u32..22 + i as u32).contains(&x) && (6..42).contains(&y)
}

fn picture(i: usize, channels: u32) -> Vec<u8> {
    let pixels = (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| is_inside(i, x, y)));
    let data: Vec<u8> = match channels {
        1 => pixels.map(|inside| if inside { 255 } else { 0 }).collect(),
        _ => pixels.flat_map(|inside| if inside { [200, 60, 40] } else { [90, 100, 110] }).collect(),
    };
    png(&data, WIDTH, HEIGHT)
}

fn png(data: &[u8], width: u32, height: u32) -> Vec<u8> {
    let colour = if data.len() == (width * height) as usize {
        image::ExtendedColorType::L8
    } else {
        image::ExtendedColorType::Rgb8
    };
    let mut bytes = Cursor::new(Vec::new());
    image::write_buffer_with_format(&mut bytes, data, width, height, colour, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}

fn zip_of(pictures: impl IntoIterator<Item = Vec<u8>>) -> Vec<u8> {
    named_zip(pictures.into_iter().enumerate().map(|(i, picture)| (format!("{i:04}.png"), picture)))
}

fn named_zip(files: impl IntoIterator<Item = (String, Vec<u8>)>) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (name, content) in files {
        zip.start_file(name, zip::write::SimpleFileOptions::default()).unwrap();
        zip.write_all(&content).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

fn keypoints(frames: usize) -> Value {
    let frame = |i: usize| (0..17).map(|k| json!([14 + i, 8 + 2 * k, 0.9])).collect::<Vec<_>>();
    json!({ "format": "coco17", "frames": (0..frames).map(frame).collect::<Vec<_>>() })
}
