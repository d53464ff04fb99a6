//! Event streams over a real connection.

use effigy::jobs::ProgressReport;
use tokio::sync::oneshot;

use super::*;

/// A listening service.
pub struct Server {
    pub bench: Bench,
    url: String,
    stop: Option<oneshot::Sender<()>>,
    ended: tokio::task::JoinHandle<std::io::Result<()>>,
}

impl Server {
    pub async fn start() -> Server {
        let bench = Bench::new().await;
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let url = format!("http://{}", listener.local_addr().unwrap());
        let (stop, stopped) = oneshot::channel::<()>();
        let end = async {
            let _ = stopped.await;
        };
        let ended = tokio::spawn(effigy::http::serve(listener, bench.app.clone(), end));
        Server { bench, url, stop: Some(stop), ended }
    }

    pub async fn follow(&self, job: Uuid, after: Option<&str>) -> Stream {
        let mut request = client().get(format!("{}/v1/jobs/{job}/events", self.url));
        if let Some(id) = after {
            request = request.header("last-event-id", id);
        }
        let response = request.send().await.unwrap();
        assert_eq!(response.status(), 200);
        assert_eq!(response.headers()["content-type"], "text/event-stream");
        Stream { response, text: String::new() }
    }
}

pub struct Stream {
    response: reqwest::Response,
    text: String,
}

#[derive(Debug, PartialEq)]
pub struct Seen {
    pub id: String,
    pub kind: String,
    pub data: Value,
}

impl Stream {
    /// The next event, or None at the end of the stream.
    pub async fn next(&mut self) -> Option<Seen> {
        loop {
            if let Some((event, rest)) = self.text.split_once("\n\n") {
                let (event, rest) = (event.to_string(), rest.to_string());
                self.text = rest;
                let field = |name: &str| event.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(": "));
                let Some(id) = field("id") else { continue };
                let data = serde_json::from_str(field("data").unwrap()).unwrap();
                return Some(Seen { id: id.into(), kind: field("event").unwrap().into(), data });
            }
            self.text.push_str(std::str::from_utf8(&self.response.chunk().await.unwrap()?).unwrap());
        }
    }
}

fn report(step: u32) -> ProgressReport {
    let losses = BTreeMap::from([("rgb".to_string(), 0.5)]);
    ProgressReport { stage: "pose".into(), step, steps: 9, progress: 0.1, eta_secs: None, losses }
}

#[tokio::test]
async fn a_stream_follows_a_job_to_its_end() {
    let server = Server::start().await;
    let id = server.bench.add_job().await;
    let mut stream = server.follow(id, None).await;
    let first = stream.next().await.unwrap();
    assert_eq!((first.kind.as_str(), &first.data["state"]), ("state", &json!("queued")));
    let lease = server.bench.claim().await;
    assert_eq!(stream.next().await.unwrap().data["state"], "running");
    server.bench.queue.report(&lease, &report(3)).await.unwrap();
    let progress = stream.next().await.unwrap();
    assert_eq!((progress.kind.as_str(), &progress.data["step"]), ("progress", &json!(3)));
    assert_eq!((&progress.data["stage"], &progress.data["losses"]), (&json!("pose"), &json!({ "rgb": 0.5 })));
    server.bench.queue.cancel(id).await.unwrap();
    assert_eq!(stream.next().await.unwrap().data["state"], "canceling");
    server.bench.queue.confirm_cancel(&lease).await.unwrap();
    assert_eq!(stream.next().await.unwrap().data["state"], "canceled");
    assert_eq!(stream.next().await, None);
}

#[tokio::test]
async fn a_client_that_comes_back_misses_nothing() {
    let server = Server::start().await;
    let id = server.bench.add_job().await;
    let lease = server.bench.claim().await;
    server.bench.queue.report(&lease, &report(1)).await.unwrap();
    let mut stream = server.follow(id, None).await;
    let mut last = String::new();
    for _ in 0..3 {
        last = stream.next().await.unwrap().id;
    }
    drop(stream);
    for step in 2..=5 {
        server.bench.queue.report(&lease, &report(step)).await.unwrap();
    }
    let mut again = server.follow(id, Some(&last)).await;
    for step in 2..=5 {
        last = again.next().await.inspect(|event| assert_eq!(event.data["step"], step)).unwrap().id;
    }
    server.bench.queue.give_back(&lease).await.unwrap();
    server.bench.queue.cancel(id).await.unwrap();
    assert_eq!(again.next().await.unwrap().data["state"], "queued");
    let end = again.next().await.unwrap();
    assert_eq!(end.data["state"], "canceled");
    // A browser that reconnects after the end is told to stay away.
    let path = format!("/v1/jobs/{id}/events");
    let gone = server.bench.call(Method::GET, &path, &[("last-event-id", &end.id)], Body::empty()).await;
    assert_eq!(gone.status, 204);
    let from_start = server.bench.get(&path).await;
    assert_eq!(String::from_utf8(from_start.body).unwrap().matches("event: ").count(), 9);
    assert!(last < end.id || last.len() < end.id.len());
    server.bench.call(Method::GET, &path, &[("last-event-id", "x")], Body::empty()).await.problem(400);
}

#[tokio::test]
async fn the_end_of_the_server_ends_its_streams() {
    let mut server = Server::start().await;
    let id = server.bench.add_job().await;
    let mut stream = server.follow(id, None).await;
    stream.next().await.unwrap();
    server.stop.take().unwrap().send(()).unwrap();
    assert_eq!(stream.next().await, None);
    server.ended.await.unwrap().unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_reconnects_all_the_time_sees_each_event_once() {
    use rand::{RngExt, SeedableRng};
    const STEPS: u32 = 150;
    let server = Server::start().await;
    let id = server.bench.add_job().await;
    let lease = server.bench.claim().await;
    let queue = server.bench.queue.clone();
    let writer = tokio::spawn(async move {
        for step in 1..=STEPS {
            queue.report(&lease, &report(step)).await.unwrap();
            tokio::time::sleep(std::time::Duration::from_millis(3)).await;
        }
        queue.fail(&lease, effigy::jobs::JobError::new("unfit", "no"), effigy::jobs::Repeat::Never).await.unwrap();
    });
    let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(3);
    let (mut seen, mut connections) = (Vec::new(), 0);
    let mut last: Option<String> = None;
    while seen.last().is_none_or(|event: &Seen| event.data["state"] != "failed") {
        connections += 1;
        let mut stream = server.follow(id, last.as_deref()).await;
        for _ in 0..random.random_range(1..9) {
            let Some(event) = stream.next().await else { break };
            last = Some(event.id.clone());
            seen.push(event);
        }
    }
    writer.await.unwrap();
    let told = server.bench.queue.events(id, 0, 10_000).await.unwrap();
    let told: Vec<String> = told.iter().map(|event| event.id.to_string()).collect();
    assert_eq!(seen.iter().map(|event| event.id.clone()).collect::<Vec<_>>(), told);
    let steps: Vec<_> = seen.iter().filter_map(|event| event.data["step"].as_u64()).collect();
    assert_eq!(steps, (1..=u64::from(STEPS)).collect::<Vec<_>>());
    assert!(connections > 20, "{connections} connections");
}
