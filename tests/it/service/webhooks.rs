//! Webhooks, with a receiver of the tests' own and a clock that stands still.

use std::collections::BTreeSet;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicU16, AtomicUsize, Ordering};
use std::time::Duration;

use axum::routing::any;
use effigy::http::{Access, Openness};
use effigy::jobs::keys::{Keys, NewKey, Quota, Scope, Token};
use effigy::jobs::webhooks::{Attempt, SCHEDULE, Webhooks};
use effigy::jobs::{JobError, ManualClock, Repeat, Timestamp};
use effigy::webhooks::{Courier, Lookup, Sender, signature, system_lookup};

use super::*;

/// What a receiver got.
#[derive(Clone, Debug)]
struct Got {
    id: String,
    timestamp: i64,
    signature: String,
    body: String,
}

/// Answers with a status and remembers.
struct Receiver {
    address: SocketAddr,
    status: Arc<AtomicU16>,
    got: Arc<Mutex<Vec<Got>>>,
}

impl Receiver {
    async fn start() -> Receiver {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let (status, got) = (Arc::new(AtomicU16::new(200)), Arc::new(Mutex::new(Vec::new())));
        let (answer, seen) = (status.clone(), got.clone());
        let router = Router::new().fallback(any(move |headers: HeaderMap, body: String| async move {
            let text = |name: &str| headers.get(name).unwrap().to_str().unwrap().to_string();
            assert_eq!(text("content-type"), "application/json");
            let timestamp = text("webhook-timestamp").parse().unwrap();
            seen.lock().unwrap().push(Got {
                id: text("webhook-id"),
                timestamp,
                signature: text("webhook-signature"),
                body,
            });
            let status = StatusCode::from_u16(answer.load(Ordering::Relaxed)).unwrap();
            (status, [("location", "http://127.0.0.1:1/elsewhere")])
        }));
        tokio::spawn(axum::serve(listener, router).into_future());
        Receiver { address, status, got }
    }

    fn take(&self) -> Vec<Got> {
        std::mem::take(&mut self.got.lock().unwrap())
    }
}

impl Bench {
    async fn telling(private: bool) -> (Bench, Arc<ManualClock>) {
        let clock = ManualClock::new(Timestamp(1_700_000_000_000));
        let mut bench = Bench::with(Limits::default(), Policy::default(), 0, Env::new(clock.clone(), 1)).await;
        bench.app = bench.app.clone().with_webhooks(bench.keys.clone(), private);
        bench.router = effigy::http::router(bench.app.clone());
        (bench, clock)
    }

    fn courier(&self, lookup: Lookup, private: bool) -> Courier {
        let sender = Sender::new(lookup, private).unwrap();
        Courier { webhooks: self.keys.clone(), sender, env: self.env.clone() }
    }

    async fn subscribe(&self, body: Value) -> Value {
        let made = self.post_json("/v1/webhooks", &body).await;
        assert_eq!(made.status, 201, "{}", String::from_utf8_lossy(&made.body));
        assert_eq!(made.header("location"), format!("/v1/webhooks/{}", made.json()["id"].as_str().unwrap()));
        made.json()
    }

    /// What has come of the messages of a webhook, the newest first.
    async fn deliveries(&self, webhook: &Value) -> Vec<Value> {
        let path = format!("/v1/webhooks/{}", webhook["id"].as_str().unwrap());
        self.get(&path).await.json()["deliveries"].as_array().unwrap().clone()
    }
}

fn secret_of(webhook: &Value) -> Vec<u8> {
    use base64::Engine;
    let text = webhook["secret"].as_str().unwrap().strip_prefix("whsec_").unwrap();
    base64::prelude::BASE64_STANDARD.decode(text).unwrap()
}

#[tokio::test]
async fn a_change_of_a_job_is_told_once_and_signed() {
    let receiver = Receiver::start().await;
    let (bench, clock) = Bench::telling(true).await;
    let url = format!("http://{}/hook", receiver.address);
    let webhook = bench.subscribe(json!({ "url": url, "events": ["job.running", "job.succeeded"] })).await;
    let courier = bench.courier(system_lookup(), true);
    assert_eq!(courier.round().await.unwrap(), 0);
    let id = bench.publish(&[("avatar.glb", b"glTF")]).await;
    clock.advance(Duration::from_secs(3));
    assert_eq!(courier.round().await.unwrap(), 2, "not of its queueing, which was not asked for");
    let got = receiver.take();
    let bodies: Vec<Value> = got.iter().map(|got| serde_json::from_str(&got.body).unwrap()).collect();
    assert_eq!((&bodies[0]["type"], &bodies[1]["type"]), (&json!("job.running"), &json!("job.succeeded")));
    assert_eq!(bodies[1]["timestamp"], "2023-11-14T22:13:20.000Z");
    let data = json!({ "job": id, "state": "succeeded", "attempt": 1, "avatar": id, "error": null });
    assert_eq!(bodies[1]["data"], data);
    let secret = secret_of(&webhook);
    assert_eq!(secret.len(), 32);
    for got in &got {
        assert_eq!(got.timestamp, 1_700_000_003);
        assert_eq!(got.signature, signature(&secret, &got.id, got.timestamp, &got.body));
        assert!(got.id.starts_with("msg_"));
    }
    assert_ne!(got[0].id, got[1].id);
    assert_eq!(courier.round().await.unwrap(), 0, "what was taken is not sent again");
    let shown = bench.deliveries(&webhook).await;
    assert_eq!(
        (&shown[0]["attempts"], &shown[0]["last_status"], &shown[0]["next_at"]),
        (&json!(1), &json!(200), &Value::Null)
    );
    assert_eq!(bench.get("/v1/webhooks").await.json()["webhooks"][0]["secret"], Value::Null, "it is told once");
}

#[tokio::test]
async fn a_job_that_is_deleted_while_it_waits_is_told_as_canceled() {
    let receiver = Receiver::start().await;
    let (bench, _) = Bench::telling(true).await;
    bench.subscribe(json!({ "url": format!("http://{}/", receiver.address) })).await;
    let job = bench.add_job().await;
    let path = format!("/v1/jobs/{job}");
    let delete = || bench.call(Method::DELETE, &path, &[], Body::empty());
    assert_eq!(delete().await.status, 204);
    assert_eq!(delete().await.status, 404);
    assert_eq!(bench.courier(system_lookup(), true).round().await.unwrap(), 1);
    let told: Value = serde_json::from_str(&receiver.take()[0].body).unwrap();
    assert_eq!((&told["type"], &told["data"]["job"]), (&json!("job.canceled"), &json!(job)));
}

#[tokio::test]
async fn what_is_not_taken_is_sent_again_for_days_and_survives_a_restart() {
    let receiver = Receiver::start().await;
    let (bench, clock) = Bench::telling(true).await;
    let webhook = bench.subscribe(json!({ "url": format!("http://{}/", receiver.address) })).await;
    let job = bench.add_job().await;
    let lease = bench.claim().await;
    bench.queue.fail(&lease, JobError::new("diverged", "offsets"), Repeat::Never).await.unwrap();
    receiver.status.store(500, Ordering::Relaxed);
    let start = bench.env.now();
    let mut ids = BTreeSet::new();
    for (made, wait) in SCHEDULE.iter().enumerate() {
        // A new courier each time: all that it knows is in the database.
        let courier = bench.courier(system_lookup(), true);
        assert_eq!((courier.round().await.unwrap(), courier.round().await.unwrap()), (1, 0));
        let got = receiver.take();
        ids.extend(got.iter().map(|got| got.id.clone()));
        assert!(got[0].body.contains(&job.to_string()) && got[0].body.contains("\"diverged\""), "{}", got[0].body);
        assert_eq!(got[0].timestamp, bench.env.now().0 / 1000, "each attempt is signed anew");
        let shown = &bench.deliveries(&webhook).await[0];
        assert_eq!((&shown["attempts"], &shown["last_status"]), (&json!(made + 1), &json!(500)));
        clock.advance(*wait - Duration::from_millis(1));
        assert_eq!(courier.round().await.unwrap(), 0, "not before its time");
        // Up to a tenth is added by chance.
        clock.advance(wait.mul_f64(0.1) + Duration::from_millis(1));
    }
    assert_eq!(ids.len(), 1, "a receiver can tell a repetition");
    let days = (bench.env.now().0 - start.0) as f64 / 86_400_000.0;
    assert!((3.0..4.0).contains(&days), "{days} days");
    receiver.status.store(204, Ordering::Relaxed);
    assert_eq!(bench.courier(system_lookup(), true).round().await.unwrap(), 1);
    assert!(bench.deliveries(&webhook).await[0]["delivered_at"].is_string());

    // One that nobody ever takes is given up in the end.
    receiver.status.store(503, Ordering::Relaxed);
    bench.queue.retry(job).await.unwrap();
    bench.queue.cancel(job).await.unwrap();
    let courier = bench.courier(system_lookup(), true);
    for _ in 0..SCHEDULE.len() + 5 {
        courier.round().await.unwrap();
        clock.advance(Duration::from_secs(30 * 3600));
    }
    let shown = &bench.deliveries(&webhook).await[0];
    assert_eq!((&shown["attempts"], &shown["next_at"]), (&json!(SCHEDULE.len() + 1), &Value::Null));
    assert_eq!(shown["delivered_at"], Value::Null);
}

#[tokio::test]
async fn gone_is_for_ever_and_a_redirection_leads_nowhere() {
    let receiver = Receiver::start().await;
    let (bench, _) = Bench::telling(true).await;
    let webhook = bench.subscribe(json!({ "url": format!("http://{}/", receiver.address) })).await;
    let courier = bench.courier(system_lookup(), true);
    receiver.status.store(307, Ordering::Relaxed);
    bench.publish(&[]).await;
    courier.round().await.unwrap();
    let shown = &bench.deliveries(&webhook).await[0];
    assert_eq!((&shown["last_status"], shown["next_at"].is_string()), (&json!(307), true));
    assert_eq!(receiver.take().len(), 1);
    receiver.status.store(410, Ordering::Relaxed);
    assert_eq!(bench.queue.figures().await.unwrap().deliveries, 1);
    bench.publish(&[]).await;
    courier.round().await.unwrap();
    assert_eq!(receiver.take().len(), 1);
    let shown = bench.deliveries(&webhook).await;
    assert!(shown.len() == 2 && shown.iter().all(|message| message["next_at"].is_null()), "{shown:?}");
    assert_eq!(bench.queue.figures().await.unwrap().deliveries, 0, "the other one waits for nothing");
    // One that was on its way when the receiver said so, and failed after.
    let late = shown[1]["id"].as_str().unwrap();
    bench.keys.attempted(late, &Attempt::Answered(500)).await.unwrap();
    assert_eq!(bench.queue.figures().await.unwrap().deliveries, 0, "nor does it wait");
    bench.publish(&[]).await;
    assert_eq!(courier.round().await.unwrap(), 0);
    assert!(bench.get("/v1/webhooks").await.json()["webhooks"][0]["disabled_at"].is_string());
}

#[tokio::test]
async fn a_receiver_that_never_answers_holds_up_its_own_messages() {
    let receiver = Receiver::start().await;
    let (bench, _) = Bench::telling(true).await;
    // Takes connections, and says nothing.
    let mute = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("http://{}/", mute.local_addr().unwrap());
    bench.subscribe(json!({ "url": url })).await;
    for _ in 0..100 {
        bench.publish(&[]).await;
    }
    bench.subscribe(json!({ "url": format!("http://{}/", receiver.address) })).await;
    let told = bench.publish(&[]).await;
    let courier = tokio::spawn(bench.courier(system_lookup(), true).run());
    let mut held = Vec::new();
    let mut second = None;
    // An attempt ends after 15 s at the earliest.
    let all = tokio::time::timeout(Duration::from_secs(10), async {
        loop {
            tokio::select! {
                connection = mute.accept() => held.push(connection.unwrap()),
                () = tokio::time::sleep(Duration::from_millis(20)) => {}
            }
            let got = receiver.got.lock().unwrap().clone();
            if got.iter().any(|got| got.body.contains(&told.to_string())) && second.is_none() {
                second = Some(bench.publish(&[]).await);
            }
            if second.is_some_and(|second| got.iter().any(|got| got.body.contains(&second.to_string()))) {
                break;
            }
        }
    });
    all.await.expect("the other receiver waits for the mute one");
    courier.abort();
    assert_eq!(receiver.take().len(), 2, "each once");
    assert!((1..=4).contains(&held.len()), "{} connections to one receiver", held.len());
}

#[tokio::test]
async fn a_key_has_so_many_webhooks_and_no_more() {
    let (bench, _) = Bench::telling(true).await;
    for _ in 0..100 {
        bench.subscribe(json!({ "url": "https://hooks.example/" })).await;
    }
    let made = bench.post_json("/v1/webhooks", &json!({ "url": "https://hooks.example/" })).await;
    assert_eq!(made.problem(429)["type"], "urn:effigy:problem:quota-exceeded");
    let listed = bench.get("/v1/webhooks").await.json()["webhooks"].as_array().unwrap().clone();
    assert_eq!(listed.len(), 100);
    let path = format!("/v1/webhooks/{}", listed[0]["id"].as_str().unwrap());
    assert_eq!(bench.call(Method::DELETE, &path, &[], Body::empty()).await.status, 204);
    bench.subscribe(json!({ "url": "https://hooks.example/" })).await;
}

/// A name service that gives these addresses, and counts how often it was asked.
fn names(addresses: &[SocketAddr]) -> (Lookup, Arc<AtomicUsize>) {
    let asked = Arc::new(AtomicUsize::new(0));
    let (count, addresses) = (asked.clone(), addresses.to_vec());
    let lookup: Lookup = Arc::new(move |_| {
        count.fetch_add(1, Ordering::Relaxed);
        let addresses = addresses.clone();
        Box::pin(async move { Ok(addresses) })
    });
    (lookup, asked)
}

#[tokio::test]
async fn a_name_that_comes_to_mean_a_private_address_is_refused() {
    let receiver = Receiver::start().await;
    let public: SocketAddr = "8.8.8.8:0".parse().unwrap();
    let private = SocketAddr::new(receiver.address.ip(), 0);
    let (bench, clock) = Bench::telling(false).await;
    // The name passes when the webhook is made; nobody asks the name service then.
    let url = format!("https://rebind.example:{}/", receiver.address.port());
    let webhook = bench.subscribe(json!({ "url": url })).await;
    bench.publish(&[]).await;
    for answer in [&[private] as &[_], &[public, private], &["[::ffff:10.0.0.1]:0".parse().unwrap()]] {
        let (lookup, _) = names(answer);
        let courier = bench.courier(lookup, false);
        assert_eq!(courier.round().await.unwrap(), 1);
        let error = bench.deliveries(&webhook).await[0]["last_error"].as_str().unwrap().to_string();
        assert!(error.contains("is not a public address"), "{error}");
        assert!(!error.contains(&answer[answer.len() - 1].ip().to_string()), "{error} tells of the network");
        clock.advance(Duration::from_secs(3600));
    }
    assert!(receiver.take().is_empty(), "the private receiver heard nothing");

    // The same name and receiver are reached where private addresses are allowed: the test would else prove nothing.
    let (bench, _) = Bench::telling(true).await;
    bench.subscribe(json!({ "url": url.replace("https", "http") })).await;
    bench.publish(&[]).await;
    let (lookup, asked) = names(&[private]);
    assert_eq!(bench.courier(lookup, true).round().await.unwrap(), 1);
    assert_eq!(asked.load(Ordering::Relaxed), 1, "the answer that was checked is the one that is used");
    assert_eq!(receiver.take().len(), 1);
}

#[tokio::test]
async fn a_webhook_that_cannot_be_is_refused() {
    let (bench, _) = Bench::telling(false).await;
    for (body, part) in [
        (json!({ "url": "http://hooks.example/" }), "url"),
        (json!({ "url": "https://127.0.0.1/" }), "url"),
        (json!({ "url": "https://[::1]/" }), "url"),
        (json!({ "url": "nonsense" }), "url"),
        (json!({ "url": format!("https://hooks.example/{}", "x".repeat(3000)) }), "url"),
        (json!({ "url": "https://hooks.example/", "events": ["job.sneezed"] }), "events"),
        (json!({ "url": "https://hooks.example/", "events": [] }), "events"),
    ] {
        assert_eq!(bench.post_json("/v1/webhooks", &body).await.problem(422)["part"], part, "{body}");
    }
    bench.post_json("/v1/webhooks", &json!({ "url": "https://a.example/", "secret": "x" })).await.problem(400);
    assert_eq!(bench.get("/v1/webhooks").await.json()["webhooks"], json!([]));
    let made = bench.subscribe(json!({ "url": "https://hooks.example/" })).await;
    let path = format!("/v1/webhooks/{}", made["id"].as_str().unwrap());
    assert_eq!(made["events"], json!(["job.canceled", "job.expired", "job.failed", "job.succeeded"]));
    assert_eq!(bench.call(Method::DELETE, &path, &[], Body::empty()).await.status, 204);
    bench.call(Method::DELETE, &path, &[], Body::empty()).await.problem(404);
    bench.get(&path).await.problem(404);
}

#[tokio::test]
async fn a_webhook_hears_of_its_keys_jobs_only() {
    let receiver = Receiver::start().await;
    let (mut bench, _) = Bench::telling(true).await;
    let access = Access::new(Openness::Keys, bench.keys.clone(), Vec::new(), vec![1; 32]);
    bench.app = bench.app.clone().with_access(access);
    bench.router = effigy::http::router(bench.app.clone());
    let mut keys = Vec::new();
    for name in ["one", "two"] {
        let token = Token::new().unwrap();
        let scopes = BTreeSet::from([Scope::Read, Scope::Write]);
        let new = NewKey { name: name.into(), scopes, quota: Quota::default(), expires_at: None };
        let id = bench.keys.create_key(&new, &token).await.unwrap().unwrap().id;
        keys.push((id, format!("Bearer {}", token.reveal())));
    }
    let call = |n: usize, method: Method, path: String, body: String| {
        let headers =
            [("authorization".to_string(), keys[n].1.clone()), ("content-type".into(), "application/json".into())];
        let bench = &bench;
        async move {
            let headers: Vec<_> = headers.iter().map(|(k, v)| (k.as_str(), v.as_str())).collect();
            bench.call(method, &path, &headers, body).await
        }
    };
    let body = json!({ "url": format!("http://{}/one", receiver.address) }).to_string();
    let made = call(0, Method::POST, "/v1/webhooks".into(), body).await.json();
    let path = format!("/v1/webhooks/{}", made["id"].as_str().unwrap());
    assert_eq!(call(0, Method::GET, path.clone(), String::new()).await.status, 200);
    call(1, Method::GET, path.clone(), String::new()).await.problem(404);
    call(1, Method::DELETE, path.clone(), String::new()).await.problem(404);
    assert_eq!(call(1, Method::GET, "/v1/webhooks".into(), String::new()).await.json()["webhooks"], json!([]));

    let courier = bench.courier(system_lookup(), true);
    bench.publish_of(Some(keys[1].0), &[]).await;
    bench.publish(&[]).await;
    assert_eq!(courier.round().await.unwrap(), 0);
    let own = bench.publish_of(Some(keys[0].0), &[]).await;
    assert_eq!(courier.round().await.unwrap(), 1);
    assert!(receiver.take()[0].body.contains(&own.to_string()));
    bench.publish_of(Some(keys[0].0), &[]).await;
    bench.keys.revoke_key("one").await.unwrap();
    bench.publish_of(Some(keys[0].0), &[]).await;
    assert_eq!(courier.round().await.unwrap(), 0, "a revoked key hears nothing, not even what waits");
}
