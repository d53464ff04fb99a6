//! Who may: keys, scopes, quotas, rates, links, origins.

use std::collections::BTreeSet;

use effigy::http::{Access, Openness};
use effigy::jobs::keys::{Key, Keys, NewKey, Quota, Scope, Token};
use effigy::jobs::{ManualClock, State, Timestamp};

use super::*;

const SECRET: [u8; 32] = [7; 32];

impl Bench {
    pub async fn guarded(openness: Openness, origins: &[&str]) -> (Bench, Arc<ManualClock>) {
        let clock = ManualClock::new(Timestamp(1_700_000_000_000));
        let mut bench = Bench::with(Limits::default(), Policy::default(), 0, Env::new(clock.clone(), 1)).await;
        let origins = origins.iter().map(ToString::to_string).collect();
        let access = Access::new(openness, bench.keys.clone(), origins, SECRET.to_vec());
        bench.app = bench.app.clone().with_access(access);
        bench.router = effigy::http::router(bench.app.clone());
        (bench, clock)
    }

    pub async fn key(&self, name: &str, scopes: &[Scope], quota: Quota) -> Asker<'_> {
        let token = Token::new().unwrap();
        let scopes = scopes.iter().copied().collect::<BTreeSet<_>>();
        let new = NewKey { name: name.into(), scopes, quota, expires_at: None };
        let key = self.keys.create_key(&new, &token).await.unwrap().unwrap();
        Asker { bench: self, key, header: format!("Bearer {}", token.reveal()) }
    }

    pub async fn job_of(&self, asker: &Asker<'_>) -> Uuid {
        self.add_job_of(Some(asker.key.id)).await
    }
}

/// Somebody with a key.
pub struct Asker<'a> {
    bench: &'a Bench,
    key: Key,
    header: String,
}

impl Asker<'_> {
    async fn call(&self, method: Method, path: &str, body: impl Into<Body>) -> Reply {
        let headers = [("authorization", self.header.as_str()), ("content-type", "application/json")];
        self.bench.call(method, path, &headers, body).await
    }

    pub async fn get(&self, path: &str) -> Reply {
        self.call(Method::GET, path, Body::empty()).await
    }

    async fn upload(&self, form: &Form) -> Reply {
        let headers = [("authorization", self.header.as_str()), ("content-type", Form::TYPE)];
        self.bench.call(Method::POST, "/v1/jobs", &headers, form.body()).await
    }
}

pub const USER: [Scope; 2] = [Scope::Read, Scope::Write];

/// Method and path of all operations, read off the description: what is added later is tested too.
fn operations() -> Vec<(Method, String)> {
    let mut found = Vec::new();
    let mut path = String::new();
    for line in effigy::http::openapi::yaml().unwrap().lines() {
        if let Some(key) = line.strip_prefix("  /").and_then(|rest| rest.strip_suffix(':')) {
            path = format!("/{key}");
        } else if let Some(key) = line.strip_prefix("    ").and_then(|rest| rest.strip_suffix(':'))
            && let Ok(method) = key.to_uppercase().parse::<Method>()
            && ["get", "head", "post", "put", "patch", "delete"].contains(&key)
        {
            found.push((method, path.clone()));
        }
    }
    assert!(found.len() > 12, "{found:?}");
    found
}

#[tokio::test]
async fn every_operation_asks_for_a_key_and_hides_what_is_anothers() {
    let (bench, _) = Bench::guarded(Openness::Keys, &[]).await;
    let (owner, other) = (bench.key("a", &USER, Quota::default()).await, bench.key("b", &USER, Quota::default()).await);
    let reader = bench.key("c", &[Scope::Read], Quota::default()).await;
    let admin = bench.key("d", &[Scope::Admin], Quota::default()).await;
    let id = bench.job_of(&owner).await;
    let lease = bench.claim().await;
    bench.show(&lease, 1, b"jpeg").await;
    bench.end_with(&lease, &[("avatar.glb", b"glTF"), ("mesh.ply", b"ply")]).await;
    let nobodys = bench.add_job().await;
    for (method, pattern) in operations() {
        let at = |id: Uuid| pattern.replace("{id}", &id.to_string()).replace("{file}", "avatar.glb");
        let path = at(id);
        let unknown = bench.call(method.clone(), &path, &[], Body::empty()).await;
        if !pattern.starts_with("/v1/") && pattern != "/metrics" {
            assert_ne!(unknown.status, 401, "{method} {pattern}");
            continue;
        }
        assert_eq!(unknown.header("www-authenticate"), "Bearer");
        if method == Method::HEAD {
            assert_eq!(unknown.status, 401, "{pattern}");
            continue;
        }
        unknown.problem(401);
        let wrong = [("authorization", "Bearer effigy_wrong")];
        bench.call(method.clone(), &path, &wrong, Body::empty()).await.problem(401);
        if pattern == "/metrics" {
            owner.get(&path).await.problem(403);
            assert_eq!(admin.get(&path).await.status, 200);
        }
        let of_a_job = pattern.starts_with("/v1/jobs/{id}") || pattern.starts_with("/v1/avatars/{id}");
        if !of_a_job {
            continue;
        }
        let (hidden, gone) =
            (other.call(method.clone(), &path, "{}").await, other.call(method.clone(), &at(Uuid::nil()), "{}").await);
        let (hidden, gone) = (hidden.problem(404), gone.problem(404));
        assert_eq!(hidden["title"], gone["title"], "{method} {pattern}: a secret job looks like none");
        other.call(method.clone(), &at(nobodys), "{}").await.problem(404);
        let changes = method != Method::GET && !pattern.ends_with("renders") && !pattern.ends_with("links");
        if changes {
            reader.call(method.clone(), &path, "{}").await.problem(403);
        }
        if method != Method::DELETE {
            for allowed in [&owner, &admin] {
                let status = allowed.call(method.clone(), &path, "{}").await.status.as_u16();
                assert!(![401, 403, 404].contains(&status), "{method} {pattern}: {status}");
            }
        }
    }
    assert_eq!(owner.call(Method::DELETE, &format!("/v1/jobs/{id}"), "").await.status, 204);
}

#[tokio::test]
async fn a_path_that_is_no_text_is_the_path_of_nothing() {
    let (bench, _) = Bench::guarded(Openness::Keys, &[]).await;
    for (name, scopes) in [("one", &USER[..]), ("boss", &[Scope::Admin])] {
        let key = bench.key(name, scopes, Quota::default()).await;
        for path in ["/v1/jobs/%ff", "/v1/jobs/%ff/events", "/v1/avatars/%ff/avatar.glb", "/v1/webhooks/%ff"] {
            assert_eq!(key.get(path).await.problem(404)["type"], "urn:effigy:problem:unknown-path", "{path}");
        }
        let headers = [("authorization", key.header.as_str()), ("tus-resumable", "1.0.0")];
        bench.call(Method::DELETE, "/v1/uploads/%ff", &headers, Body::empty()).await.problem(404);
    }
}

#[tokio::test]
async fn a_list_shows_what_is_ones_own() {
    let (bench, _) = Bench::guarded(Openness::Keys, &[]).await;
    let (one, two) = (bench.key("one", &USER, Quota::default()).await, bench.key("two", &USER, Quota::default()).await);
    let admin = bench.key("boss", &[Scope::Admin], Quota::default()).await;
    let (first, second) = (bench.job_of(&one).await, bench.job_of(&two).await);
    let nobodys = bench.add_job().await;
    for (asker, expected) in [(&one, vec![first]), (&two, vec![second]), (&admin, vec![nobodys, second, first])] {
        let list = asker.get("/v1/jobs").await.json();
        let ids: Vec<Uuid> =
            list["jobs"].as_array().unwrap().iter().map(|j| j["id"].as_str().unwrap().parse().unwrap()).collect();
        assert_eq!(ids, expected, "{}", asker.key.name);
    }
}

#[tokio::test]
async fn a_quota_of_waiting_jobs_and_of_bytes_holds() {
    let (bench, _) = Bench::guarded(Openness::Keys, &[]).await;
    let size: u64 = Form::clip().0.iter().map(|(_, content)| content.len() as u64).sum();
    let few = bench.key("few", &USER, Quota { max_queued: Some(1), ..Quota::default() }).await;
    let small = bench.key("small", &USER, Quota { max_bytes: Some(size + size / 2), ..Quota::default() }).await;
    let first = few.upload(&Form::clip()).await;
    assert_eq!(first.status, 202);
    let second = few.upload(&Form::clip()).await;
    assert_eq!(second.problem(429)["type"], "urn:effigy:problem:quota-exceeded");
    assert_eq!(second.header("retry-after"), "60");
    // Before the body is read: this is none.
    let headers = [("authorization", few.header.as_str()), ("content-type", Form::TYPE)];
    let early = bench.call(Method::POST, "/v1/jobs", &headers, "no form").await;
    assert_eq!(early.problem(429)["type"], "urn:effigy:problem:quota-exceeded");
    let path = format!("/v1/jobs/{}/cancel", first.json()["id"].as_str().unwrap());
    few.call(Method::POST, &path, "").await;
    assert_eq!(few.upload(&Form::clip()).await.status, 202, "a canceled job does not wait");
    let again = few.call(Method::POST, &path.replace("cancel", "retry"), "").await;
    assert_eq!(again.problem(429)["type"], "urn:effigy:problem:quota-exceeded", "a retried one does");

    let kept = small.upload(&Form::clip()).await.json();
    // What is left is less than such an upload.
    let refused = small.upload(&Form::clip()).await.problem(429);
    assert_eq!(refused["type"], "urn:effigy:problem:quota-exceeded");
    assert!(refused["detail"].as_str().unwrap().ends_with(&format!("of which {} are left", size / 2)), "{refused}");
    small.call(Method::DELETE, &format!("/v1/jobs/{}", kept["id"].as_str().unwrap()), "").await;
    assert_eq!(small.upload(&Form::clip()).await.status, 202);
    // Nothing of what was refused is left: two jobs of the first key, one of the second.
    assert_eq!(bench.store.job_folders().unwrap().len(), 3);
    assert_eq!(std::fs::read_dir(bench.store.root().join("tmp")).unwrap().count(), 0);
}

#[tokio::test]
async fn what_open_uploads_were_promised_is_not_for_a_form() {
    let (bench, _) = Bench::guarded(Openness::Keys, &[]).await;
    let size: u64 = Form::clip().0.iter().map(|(_, content)| content.len() as u64).sum();
    let small = bench.key("small", &USER, Quota { max_bytes: Some(size + 500), ..Quota::default() }).await;
    let own = of_bytes(600);
    let headers = [("authorization", small.header.as_str()), ("tus-resumable", &own[0].1), (own[1].0, &own[1].1)];
    let begun = bench.call(Method::POST, "/v1/uploads", &headers, Body::empty()).await;
    assert_eq!(begun.status, 201);
    assert_eq!(small.upload(&Form::clip()).await.problem(429)["type"], "urn:effigy:problem:quota-exceeded");
    bench.call(Method::DELETE, begun.header("location"), &headers[..2], Body::empty()).await;

    // Those that it uses are its own bytes, not others'.
    let clip = Form::clip();
    let video = clip.0.iter().find(|(part, _)| part == "video").unwrap().1.clone();
    let own = of_bytes(video.len() as u64);
    let headers = [("authorization", small.header.as_str()), ("tus-resumable", &own[0].1), (own[1].0, &own[1].1)];
    let begun = bench.call(Method::POST, "/v1/uploads", &headers, Body::empty()).await;
    let path = begun.header("location");
    let piece = [headers[0], headers[1], ("upload-offset", "0"), ("content-type", "application/offset+octet-stream")];
    assert_eq!(bench.call(Method::PATCH, path, &piece, video).await.status, 204);
    let named = json!({ "video": path.rsplit('/').next().unwrap() }).to_string();
    let job = small.upload(&clip.without("video").with("uploads", named)).await;
    assert_eq!(job.status, 202, "{}", job.json());
}

/// `upload-length` and the protocol's version.
fn of_bytes(bytes: u64) -> [(&'static str, String); 2] {
    [("tus-resumable", "1.0.0".into()), ("upload-length", bytes.to_string())]
}

#[tokio::test]
async fn resumable_uploads_are_ones_own_and_count_towards_the_quota() {
    let (bench, _) = Bench::guarded(Openness::Keys, &[]).await;
    let one = bench.key("one", &USER, Quota { max_bytes: Some(1000), ..Quota::default() }).await;
    let two = bench.key("two", &USER, Quota::default()).await;
    let admin = bench.key("boss", &[Scope::Admin], Quota::default()).await;
    let ask = async |asker: &Asker, method: Method, path: &str, bytes: u64| {
        let own = of_bytes(bytes);
        let headers = [("authorization", asker.header.as_str()), ("tus-resumable", &own[0].1), (own[1].0, &own[1].1)];
        bench.call(method, path, &headers, Body::empty()).await
    };
    let begun = ask(&one, Method::POST, "/v1/uploads", 600).await;
    assert_eq!(begun.status, 201);
    let path = begun.header("location");
    let refused = ask(&one, Method::POST, "/v1/uploads", 401).await.problem(429);
    assert_eq!(refused["type"], "urn:effigy:problem:quota-exceeded", "{refused}");
    assert_eq!(ask(&one, Method::POST, "/v1/uploads", 400).await.status, 201);
    assert_eq!(ask(&two, Method::POST, "/v1/uploads", 5000).await.status, 201, "another key has its own");

    assert_eq!(ask(&two, Method::HEAD, path, 0).await.status, 404);
    ask(&two, Method::DELETE, path, 0).await.problem(404);
    assert_eq!(ask(&one, Method::HEAD, path, 0).await.status, 200);
    assert_eq!(ask(&admin, Method::HEAD, path, 0).await.status, 200);
    let id = path.rsplit('/').next().unwrap();
    let theft = json!({ "uploads": { "video": id, "masks": id, "keypoints": id } });
    let theft = two.call(Method::POST, "/v1/jobs", theft.to_string()).await.problem(422);
    assert!(theft["detail"].as_str().unwrap().contains("there is no upload"), "{theft}");
    assert_eq!(ask(&one, Method::DELETE, path, 0).await.status, 204);
    assert_eq!(ask(&one, Method::POST, "/v1/uploads", 500).await.status, 201, "what is given up counts no more");

    // Who may only write goes on after a cut, too.
    let cam = bench.key("cam", &[Scope::Write], Quota::default()).await;
    let begun = ask(&cam, Method::POST, "/v1/uploads", 100).await;
    assert_eq!(ask(&cam, Method::HEAD, begun.header("location"), 0).await.status, 200);
    cam.get("/v1/jobs").await.problem(403);

    // Nor can one key hold all the places: a quarter of the usual hundred. It has two.
    for _ in 2..25 {
        assert_eq!(ask(&one, Method::POST, "/v1/uploads", 0).await.status, 201);
    }
    let refused = ask(&one, Method::POST, "/v1/uploads", 0).await.problem(429);
    assert!(refused["expected"].as_str().unwrap().contains("at most 25 uploads of one key"), "{refused}");
    assert_eq!(ask(&two, Method::POST, "/v1/uploads", 0).await.status, 201);
}

#[tokio::test]
async fn a_key_that_is_full_still_gets_its_answers_again() {
    let (bench, _) = Bench::guarded(Openness::Keys, &[]).await;
    let size: u64 = Form::clip().0.iter().map(|(_, content)| content.len() as u64).sum();
    let quota = Quota { max_queued: Some(1), max_bytes: Some(size), ..Quota::default() };
    let full = bench.key("full", &USER, quota).await;
    let send = async |name: &str| {
        let headers =
            [("authorization", full.header.as_str()), ("content-type", Form::TYPE), ("idempotency-key", name)];
        bench.call(Method::POST, "/v1/jobs", &headers, Form::clip().body()).await
    };
    let first = send("a").await;
    assert_eq!(first.status, 202);
    let again = send("a").await;
    assert_eq!((again.status.as_u16(), again.header("idempotency-replayed")), (202, "true"));
    assert_eq!(again.body, first.body);
    assert_eq!(send("b").await.problem(429)["type"], "urn:effigy:problem:quota-exceeded");
}

#[tokio::test]
async fn a_key_with_enough_running_jobs_lets_others_pass() {
    let (bench, _) = Bench::guarded(Openness::Keys, &[]).await;
    let one = bench.key("one", &USER, Quota { max_running: Some(1), ..Quota::default() }).await;
    let two = bench.key("two", &USER, Quota::default()).await;
    let jobs = [bench.job_of(&one).await, bench.job_of(&one).await, bench.job_of(&two).await];
    let first = bench.claim().await;
    assert_eq!((first.job, bench.claim().await.job), (jobs[0], jobs[2]));
    assert!(bench.queue.claim("w").await.unwrap().is_none(), "the second job waits for the first");
    assert_eq!(bench.queue.get(jobs[1]).await.unwrap().unwrap().state, State::Queued);
    bench.queue.give_back(&first).await.unwrap();
    assert_eq!(bench.claim().await.job, jobs[0]);
}

#[tokio::test]
async fn a_key_has_so_many_requests_a_minute() {
    let (bench, clock) = Bench::guarded(Openness::Keys, &[]).await;
    let busy = bench.key("busy", &USER, Quota { per_minute: Some(3), ..Quota::default() }).await;
    let calm = bench.key("calm", &USER, Quota { per_minute: Some(3), ..Quota::default() }).await;
    for _ in 0..3 {
        assert_eq!(busy.get("/v1/jobs").await.status, 200);
    }
    let reply = busy.get("/v1/jobs").await;
    assert_eq!(reply.problem(429)["type"], "urn:effigy:problem:rate-limited");
    assert_eq!(reply.header("retry-after"), "20");
    assert_eq!(calm.get("/v1/jobs").await.status, 200);
    clock.advance(std::time::Duration::from_secs(20));
    assert_eq!((busy.get("/v1/jobs").await.status.as_u16(), busy.get("/v1/jobs").await.status.as_u16()), (200, 429));
}

#[tokio::test]
async fn a_last_key_that_ends_does_not_open_the_server_again() {
    let (bench, _) = Bench::guarded(Openness::Local, &[]).await;
    assert_eq!(bench.get("/v1/jobs").await.status, 200, "a server on its own machine without keys");
    let only = bench.key("only", &USER, Quota::default()).await;
    bench.get("/v1/jobs").await.problem(401);
    bench.keys.revoke_key("only").await.unwrap();
    bench.get("/v1/jobs").await.problem(401);
    only.get("/v1/jobs").await.problem(401);
}

#[tokio::test]
async fn keys_end_by_time_and_by_hand() {
    let (bench, clock) = Bench::guarded(Openness::Keys, &[]).await;
    let token = Token::new().unwrap();
    let end = bench.env.now().plus(std::time::Duration::from_secs(60));
    let new =
        NewKey { name: "short".into(), scopes: BTreeSet::from(USER), quota: Quota::default(), expires_at: Some(end) };
    let key = bench.keys.create_key(&new, &token).await.unwrap().unwrap();
    assert!(bench.keys.create_key(&new, &Token::new().unwrap()).await.unwrap().is_none(), "one living key a name");
    let short = Asker { bench: &bench, key, header: format!("bearer {}", token.reveal()) };
    let lasting = bench.key("lasting", &USER, Quota::default()).await;
    assert_eq!(
        (short.get("/v1/jobs").await.status.as_u16(), lasting.get("/v1/jobs").await.status.as_u16()),
        (200, 200)
    );
    clock.advance(std::time::Duration::from_secs(60));
    short.get("/v1/jobs").await.problem(401);
    assert!(bench.keys.revoke_key("lasting").await.unwrap().is_some());
    lasting.get("/v1/jobs").await.problem(401);
    assert!(bench.keys.revoke_key("lasting").await.unwrap().is_none());
    assert!(
        bench
            .keys
            .create_key(&NewKey { name: "lasting".into(), ..new }, &Token::new().unwrap())
            .await
            .unwrap()
            .is_some()
    );
}

#[tokio::test]
async fn tokens_are_not_in_the_database() {
    let (bench, _) = Bench::guarded(Openness::Keys, &[]).await;
    let asker = bench.key("a", &USER, Quota::default()).await;
    let secret = asker.header.strip_prefix("Bearer effigy_").unwrap();
    assert_eq!(secret.len(), 43, "256 bits");
    for file in
        std::fs::read_dir(bench.store.root()).unwrap().map(|entry| entry.unwrap().path()).filter(|p| p.is_file())
    {
        let content = std::fs::read(&file).unwrap();
        assert!(!content.windows(16).any(|window| window == &secret.as_bytes()[..16]), "{}", file.display());
    }
}

#[tokio::test]
async fn without_keys_only_this_machine_itself_is_heard() {
    let (bench, _) = Bench::guarded(Openness::Local, &["https://friend.example"]).await;
    let ask =
        |headers: &'static [(&'static str, &'static str)]| bench.call(Method::GET, "/v1/jobs", headers, Body::empty());
    for allowed in [
        &[] as &[_],
        &[("host", "localhost:8080")],
        &[("host", "127.0.0.1:8080"), ("origin", "http://127.0.0.1:8080")],
        &[("host", "[::1]:8080"), ("origin", "https://friend.example")],
    ] {
        assert_eq!(ask(allowed).await.status, 200, "{allowed:?}");
    }
    for refused in [
        // DNS rebinding, a page elsewhere, a page at another port, a proxy.
        &[("host", "evil.example:8080")] as &[_],
        &[("host", "localhost:8080"), ("origin", "https://evil.example")],
        &[("host", "localhost:8080"), ("origin", "http://localhost:3000")],
        &[("host", "localhost:8080"), ("origin", "null")],
        &[("host", "localhost:8080"), ("x-forwarded-for", "203.0.113.9")],
    ] {
        ask(refused).await.problem(403);
    }
    let asker = bench.key("first", &USER, Quota::default()).await;
    ask(&[]).await.problem(401);
    assert_eq!(asker.get("/v1/jobs").await.status, 200);

    let (open, _) = Bench::guarded(Openness::Open, &[]).await;
    assert_eq!(open.call(Method::GET, "/v1/jobs", &[("host", "example.org")], Body::empty()).await.status, 200);
}

#[tokio::test]
async fn a_link_opens_one_file_for_a_while() {
    let (bench, clock) = Bench::guarded(Openness::Keys, &[]).await;
    let owner = bench.key("owner", &USER, Quota::default()).await;
    let files: [(&str, &[u8]); 3] = [("avatar.glb", b"glTF"), ("mesh.ply", b"ply"), ("report.json", b"{}")];
    let id = bench.publish_of(Some(owner.key.id), &files).await;
    let other = bench.publish_of(Some(owner.key.id), &files).await;
    let path = format!("/v1/avatars/{id}/links");
    let made = owner.call(Method::POST, &path, json!({ "expires_in_secs": 600 }).to_string()).await.json();
    assert_eq!(made["expires_at"], "2023-11-14T22:23:20.000Z");
    let links = made["links"].as_object().unwrap();
    assert_eq!(links.keys().collect::<Vec<_>>(), ["avatar.glb", "mesh.ply", "report.json"]);
    for (name, content) in files {
        assert_eq!(bench.get(links[name].as_str().unwrap()).await.body, content, "{name}");
    }
    let link = links["avatar.glb"].as_str().unwrap().to_string();
    let part = bench.call(Method::GET, &link, &[("range", "bytes=1-2")], Body::empty()).await;
    assert_eq!((part.status.as_u16(), part.body.as_slice()), (206, &b"lT"[..]));
    assert_eq!(bench.call(Method::HEAD, &link, &[], Body::empty()).await.status, 200);

    let expires = "expires=1700000600";
    assert!(link.contains(expires));
    for forged in [
        link.replace("avatar.glb", "report.json"),
        link.replace(&id.to_string(), &other.to_string()),
        link.replace(expires, "expires=1800000000"),
        link.replace(&owner.key.id.to_string(), &Uuid::nil().to_string()),
        link.replace(&format!("&key={}", owner.key.id), ""),
        format!("{link}&frame=1"),
        links["mesh.ply"].as_str().unwrap().replace("mesh.ply?", "mesh.ply?frame=1&"),
        format!("{}A", &link[..link.len() - 1]),
        link[..link.len() - 5].to_string(),
    ] {
        bench.get(&forged).await.problem(403);
    }
    bench.call(Method::POST, &link, &[], Body::empty()).await.problem(401);
    let no_file = link.replace("/avatar.glb?", "?");
    bench.get(&no_file).await.problem(401);

    clock.advance(std::time::Duration::from_secs(599));
    assert_eq!(bench.get(&link).await.status, 200);
    clock.advance(std::time::Duration::from_secs(1));
    assert!(bench.get(&link).await.problem(403)["detail"].as_str().unwrap().contains("expired"));

    let again = owner.call(Method::POST, &path, json!({ "files": ["avatar.glb"] }).to_string()).await.json();
    let link = again["links"]["avatar.glb"].as_str().unwrap();
    assert_eq!((bench.get(link).await.status.as_u16(), again["links"].as_object().unwrap().len()), (200, 1));
    for (body, status) in [
        (json!({ "files": ["avatar.vrm"] }), 404),
        (json!({ "expires_in_secs": 0 }), 400),
        (json!({ "expires_in_secs": 700_000 }), 400),
        (json!({ "for": "me" }), 400),
    ] {
        owner.call(Method::POST, &path, body.to_string()).await.problem(status);
    }
    bench.keys.revoke_key("owner").await.unwrap();
    bench.get(link).await.problem(403);
}

#[tokio::test]
async fn pages_of_configured_origins_may_call() {
    let preflight = |bench: &Bench, origin: &'static str| {
        let headers = [
            ("origin", origin),
            ("access-control-request-method", "POST"),
            ("access-control-request-headers", "authorization,content-type"),
        ];
        let request = headers
            .iter()
            .fold(Request::builder().method(Method::OPTIONS).uri("/v1/jobs"), |r, (k, v)| r.header(*k, *v));
        let router = bench.router.clone();
        async move { router.oneshot(request.body(Body::empty()).unwrap()).await.unwrap() }
    };
    let (bench, _) = Bench::guarded(Openness::Keys, &["https://friend.example"]).await;
    let allowed = preflight(&bench, "https://friend.example").await;
    assert_eq!(allowed.status(), 200, "a preflight carries no key");
    assert_eq!(allowed.headers()["access-control-allow-origin"], "https://friend.example");
    assert_eq!(allowed.headers()["access-control-allow-headers"], "authorization,content-type");
    assert!(!preflight(&bench, "https://evil.example").await.headers().contains_key("access-control-allow-origin"));
    let denied = bench.call(Method::GET, "/v1/jobs", &[("origin", "https://friend.example")], Body::empty()).await;
    assert_eq!(denied.header("access-control-allow-origin"), "https://friend.example", "refusals can be read too");
    denied.problem(401);
    // What a server can do with uploads is asked by OPTIONS, too, and not about origins.
    let key = bench.key("page", &USER, Quota::default()).await;
    let headers = [("origin", "https://friend.example"), ("authorization", key.header.as_str())];
    let abilities = bench.call(Method::OPTIONS, "/v1/uploads", &headers, Body::empty()).await;
    assert_eq!((abilities.status.as_u16(), abilities.header("tus-version")), (204, "1.0.0"));
    assert_eq!(abilities.header("access-control-allow-origin"), "https://friend.example");
    assert!(allowed.headers()["access-control-allow-methods"].to_str().unwrap().contains("OPTIONS"));
    let (none, _) = Bench::guarded(Openness::Open, &[]).await;
    assert!(!preflight(&none, "https://friend.example").await.headers().contains_key("access-control-allow-origin"));
}
