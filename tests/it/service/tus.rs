//! Resumable uploads: the protocol, cuts at random places, restarts between, and the client that the web uses.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use effigy::http::Pace;
use effigy::jobs::{Clock, ManualClock, SystemClock, Timestamp};
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use sha1::Sha1;
use sha2::{Digest, Sha256};

use super::process::Serve;
use super::*;

const TUS: (&str, &str) = ("tus-resumable", "1.0.0");
const PIECE: (&str, &str) = ("content-type", "application/offset+octet-stream");

impl Bench {
    async fn begin(&self, bytes: usize) -> String {
        let length = bytes.to_string();
        let reply = self.call(Method::POST, "/v1/uploads", &[TUS, ("upload-length", &length)], Body::empty()).await;
        assert_eq!(reply.status, 201, "{}", String::from_utf8_lossy(&reply.body));
        assert_eq!(reply.header("tus-resumable"), "1.0.0");
        reply.header("location").to_string()
    }

    async fn patch(&self, path: &str, offset: usize, extra: &[(&str, &str)], body: &[u8]) -> Reply {
        let offset = offset.to_string();
        let headers = [&[TUS, PIECE, ("upload-offset", offset.as_str())], extra].concat();
        self.call(Method::PATCH, path, &headers, body.to_vec()).await
    }

    async fn offset(&self, path: &str) -> usize {
        let reply = self.call(Method::HEAD, path, &[TUS], Body::empty()).await;
        assert_eq!((reply.status.as_u16(), reply.header("cache-control")), (200, "no-store"));
        reply.header("upload-offset").parse().unwrap()
    }

    /// Uploads a whole file; returns its id.
    async fn put(&self, content: &[u8]) -> String {
        let path = self.begin(content.len()).await;
        if !content.is_empty() {
            assert_eq!(self.patch(&path, 0, &[], content).await.status, 204);
        }
        path.rsplit('/').next().unwrap().to_string()
    }
}

#[tokio::test]
async fn the_protocol_is_kept() {
    let bench = Bench::new().await;
    let abilities = bench.call(Method::OPTIONS, "/v1/uploads", &[], Body::empty()).await;
    assert_eq!((abilities.status.as_u16(), abilities.header("tus-version")), (204, "1.0.0"));
    assert_eq!(abilities.header("tus-extension"), "creation,termination,checksum,expiration");
    assert_eq!(abilities.header("tus-max-size"), Limits::default().upload_bytes.to_string());

    let metadata = ("upload-metadata", "filename dmlkZW8ubXA0,empty");
    let begun = bench.call(Method::POST, "/v1/uploads", &[TUS, ("upload-length", "10"), metadata], Body::empty()).await;
    let path = begun.header("location").to_string();
    assert!(begun.header("upload-expires").ends_with(" GMT"));
    let told = bench.call(Method::HEAD, &path, &[TUS], Body::empty()).await;
    assert_eq!((told.header("upload-length"), told.header("upload-offset")), ("10", "0"));
    assert_eq!(told.header("upload-metadata"), metadata.1);

    let first = bench.patch(&path, 0, &[], b"01234").await;
    assert_eq!((first.status.as_u16(), first.header("upload-offset")), (204, "5"));
    assert_eq!(bench.patch(&path, 0, &[], b"01234").await.problem(409)["expected"], "5");
    bench.patch(&path, 5, &[], b"567890").await.problem(413);
    assert_eq!(bench.offset(&path).await, 5, "what is too much is not kept");
    let sha1 = format!("sha1 {}", BASE64_STANDARD.encode(Sha1::digest(b"567")));
    assert_eq!(bench.patch(&path, 5, &[("upload-checksum", &sha1)], b"56x").await.problem(460)["status"], 460);
    assert_eq!(bench.offset(&path).await, 5);
    assert_eq!(bench.patch(&path, 5, &[("upload-checksum", &sha1)], b"567").await.status, 204);
    bench.patch(&path, 8, &[("upload-checksum", "md5 eA==")], b"89").await.problem(400);
    let sha256 = format!("sha256 {}", BASE64_STANDARD.encode(Sha256::digest(b"89")));
    let override_ =
        [TUS, PIECE, ("upload-offset", "8"), ("x-http-method-override", "PATCH"), ("upload-checksum", &sha256)];
    assert_eq!(bench.call(Method::POST, &path, &override_, "89").await.status, 204);
    assert_eq!(bench.offset(&path).await, 10);

    // Wrong versions, types and headers.
    let reply = bench.call(Method::POST, "/v1/uploads", &[("upload-length", "1")], Body::empty()).await;
    assert_eq!(reply.header("tus-version"), "1.0.0");
    reply.problem(412);
    bench.call(Method::PATCH, &path, &[TUS, ("upload-offset", "10")], "x").await.problem(415);
    bench.call(Method::POST, "/v1/uploads", &[TUS], Body::empty()).await.problem(400);
    let bad = [TUS, ("upload-length", "1"), ("upload-metadata", "name not base64!")];
    bench.call(Method::POST, "/v1/uploads", &bad, Body::empty()).await.problem(400);
    bench.call(Method::POST, &path, &[TUS], Body::empty()).await.problem(405);

    assert_eq!(bench.call(Method::DELETE, &path, &[TUS], Body::empty()).await.status, 204);
    assert_eq!(bench.call(Method::HEAD, &path, &[TUS], Body::empty()).await.status, 404);
    bench.patch("/v1/uploads/../../effigy.db", 0, &[], b"x").await.problem(404);
    bench.assert_empty();
}

#[tokio::test]
async fn what_is_too_much_is_refused_at_the_start() {
    let limits = Limits { upload_bytes: 1000, open_uploads: 3, open_upload_bytes: 2500, ..Limits::default() };
    let bench = Bench::with_limits(limits).await;
    let ask = async |bytes: &str| {
        bench.call(Method::POST, "/v1/uploads", &[TUS, ("upload-length", bytes)], Body::empty()).await
    };
    assert_eq!(ask("1001").await.problem(413)["expected"], "at most 1000 bytes");
    let path = bench.begin(1000).await;
    bench.begin(1000).await;
    let reply = ask("501").await;
    assert!(reply.headers.contains_key("retry-after"));
    assert!(reply.problem(429)["expected"].as_str().unwrap().contains("2500"));
    bench.begin(500).await;
    assert!(ask("0").await.problem(429)["expected"].as_str().unwrap().contains("at most 3 uploads"));
    bench.call(Method::DELETE, &path, &[TUS], Body::empty()).await;
    bench.begin(0).await;
    let full = Bench::with(Limits::default(), Policy::default(), 1 << 60, Env::system()).await;
    full.call(Method::POST, "/v1/uploads", &[TUS, ("upload-length", "1")], Body::empty()).await.problem(507);
}

#[tokio::test]
async fn room_that_was_promised_is_not_promised_again() {
    const GIB: u64 = 1 << 30;
    let free = Store::open(tempfile::tempdir().unwrap().path()).unwrap().free_bytes().unwrap();
    // Of about 3 GiB two uploads of 2 GiB have no place. Others may use the disk meanwhile, hence such sizes.
    let bench = Bench::with(Limits::default(), Policy::default(), free.saturating_sub(3 * GIB), Env::system()).await;
    bench.begin(2 * GIB as usize).await;
    let length = (2 * GIB).to_string();
    let second = bench.call(Method::POST, "/v1/uploads", &[TUS, ("upload-length", &length)], Body::empty()).await;
    assert_eq!(second.problem(507)["type"], "urn:effigy:problem:disk-full");
}

#[tokio::test]
async fn the_end_of_an_upload_is_told_by_the_service_s_clock() {
    let clock = ManualClock::new(Timestamp(1_700_000_000_000));
    let limits = Limits { upload_ttl: Duration::from_secs(3600), ..Limits::default() };
    let bench = Bench::with(limits, Policy::default(), 0, Env::new(clock.clone(), 1)).await;
    let begun = bench.call(Method::POST, "/v1/uploads", &[TUS, ("upload-length", "10")], Body::empty()).await;
    assert_eq!(begun.header("upload-expires"), "Tue, 14 Nov 2023 23:13:20 GMT");
    clock.advance(Duration::from_secs(60));
    let piece = bench.patch(begun.header("location"), 0, &[], b"12345").await;
    assert_eq!(piece.header("upload-expires"), "Tue, 14 Nov 2023 23:14:20 GMT");
}

#[tokio::test]
async fn what_nobody_goes_on_with_expires() {
    let clock = ManualClock::new(SystemClock.now());
    let limits = Limits { upload_ttl: Duration::from_secs(3600), ..Limits::default() };
    let bench = Bench::with(limits, Policy::default(), 0, Env::new(clock.clone(), 1)).await;
    let path = bench.begin(10).await;
    clock.advance(Duration::from_secs(3500));
    bench.app.expire_uploads().await;
    assert_eq!(bench.offset(&path).await, 0);
    clock.advance(Duration::from_secs(200));
    bench.app.expire_uploads().await;
    assert_eq!(bench.call(Method::HEAD, &path, &[TUS], Body::empty()).await.status, 404);
    assert!(bench.store.resumable_ids().unwrap().is_empty());
    bench.assert_empty();
}

#[tokio::test]
async fn an_upload_keeps_its_age_when_the_wall_clock_is_set() {
    for forward in [true, false] {
        // Files have the system's time; what the test does takes less than the seconds that the clock is ahead.
        let clock = ManualClock::new(SystemClock.now().plus(Duration::from_secs(60)));
        let limits = Limits { upload_ttl: Duration::from_secs(3600), ..Limits::default() };
        let bench = Bench::with(limits, Policy::default(), 0, Env::new(clock.clone(), 1)).await;
        let path = bench.begin(10).await;
        bench.app.expire_uploads().await;
        clock.leap(Duration::from_secs(86_400), forward);
        bench.app.expire_uploads().await;
        clock.advance(Duration::from_secs(3400));
        bench.app.expire_uploads().await;
        assert_eq!(bench.offset(&path).await, 0, "forward: {forward}");
        clock.advance(Duration::from_secs(300));
        bench.app.expire_uploads().await;
        assert_eq!(bench.call(Method::HEAD, &path, &[TUS], Body::empty()).await.status, 404, "forward: {forward}");
    }
}

#[tokio::test]
async fn a_job_is_made_of_uploads() {
    let bench = Bench::new().await;
    let mut ids = BTreeMap::new();
    for (part, content) in Form::clip().0 {
        ids.insert(part, bench.put(&content).await);
    }
    let camera = json!({ "width": WIDTH, "height": HEIGHT, "fx": 60, "fy": 60, "cx": 16, "cy": 24 });
    let asked = json!({ "uploads": ids, "camera": camera, "options": { "preset": "draft" } });
    // What is refused leaves the uploads as they are.
    let mut bad = asked.clone();
    bad["options"]["preset"] = json!("best");
    assert_eq!(bench.post_json("/v1/jobs", &bad).await.problem(400)["part"], "options.preset");
    bad = asked.clone();
    bad["uploads"]["masks"] = json!(bench.put(b"no masks").await);
    assert_eq!(bench.post_json("/v1/jobs", &bad).await.problem(422)["part"], "masks");
    bad["uploads"]["masks"] = json!(Uuid::nil());
    assert_eq!(bench.post_json("/v1/jobs", &bad).await.problem(422)["part"], "uploads.masks");
    bad["uploads"]["masks"] = json!(bench.begin(5).await.rsplit('/').next());
    let problem = bench.post_json("/v1/jobs", &bad).await.problem(422);
    assert!(problem["detail"].as_str().unwrap().contains("0 of 5 bytes"), "{problem}");
    bad["uploads"]["masks"] = json!("../x");
    assert_eq!(bench.post_json("/v1/jobs", &bad).await.problem(400)["part"], "uploads.masks");
    bad = asked.clone();
    bad["uploads"].as_object_mut().unwrap().remove("video");
    assert_eq!(bench.post_json("/v1/jobs", &bad).await.problem(400)["part"], "video");
    let more = format!("{asked} {{}}");
    let more = bench.call(Method::POST, "/v1/jobs", &[("content-type", "application/json")], more).await.problem(400);
    assert_eq!(more["expected"], "nothing after the object", "{more}");
    let deep = format!("{{\"camera\": {}", "[".repeat(20_000));
    bench.call(Method::POST, "/v1/jobs", &[("content-type", "application/json")], deep).await.problem(400);
    let long = " ".repeat(100_000);
    bench.call(Method::POST, "/v1/jobs", &[("content-type", "application/json")], long).await.problem(413);

    let key = [("content-type", "application/json"), ("idempotency-key", "k")];
    let reply = bench.call(Method::POST, "/v1/jobs", &key, asked.to_string()).await;
    assert_eq!(reply.status, 202, "{}", reply.json());
    let job = reply.json();
    assert_eq!((&job["options"]["preset"], &job["clip"]["frames"]), (&json!("draft"), &json!(4)));
    let inputs = bench.store.inputs(job["id"].as_str().unwrap().parse().unwrap());
    for (part, content) in Form::clip().0 {
        assert_eq!(std::fs::read(inputs.join(&part)).unwrap(), content, "{part}");
        // The job has used it up.
        let path = format!("/v1/uploads/{}", ids[&part]);
        assert_eq!(bench.call(Method::HEAD, &path, &[TUS], Body::empty()).await.status, 404);
    }
    // The same request again finds its answer, though the uploads are gone.
    assert_eq!(bench.call(Method::POST, "/v1/jobs", &key, asked.to_string()).await.json(), job);

    // Of many who give the same uploads at once, one gets a job.
    let mut ids = BTreeMap::new();
    for (part, content) in Form::clip().0 {
        ids.insert(part, bench.put(&content).await);
    }
    let asked = json!({ "uploads": ids });
    let all = futures_util::future::join_all((0..4).map(|_| bench.post_json("/v1/jobs", &asked))).await;
    let statuses: BTreeMap<u16, usize> = all.iter().fold(BTreeMap::new(), |mut counts, reply| {
        *counts.entry(reply.status.as_u16()).or_default() += 1;
        counts
    });
    assert_eq!(statuses, BTreeMap::from([(202, 1), (422, 3)]));

    // A form may bring some parts itself.
    let video = bench.put(&Form::clip().0[0].1).await;
    let mixed = Form::clip().without("video").with("uploads", json!({ "video": video }).to_string());
    assert_eq!(bench.upload(&mixed).await.status, 202);
    let twice = Form::clip().with("uploads", json!({ "video": video }).to_string());
    assert_eq!(bench.upload(&twice).await.problem(400)["part"], "video");
}

#[tokio::test]
async fn a_trickle_is_cut() {
    let pace = Pace { window: Duration::from_millis(150), bytes: 1000 };
    let bench = Bench::with_limits(Limits { pace, ..Limits::default() }).await;
    let trickle = |start: Vec<u8>| {
        let bytes = futures_util::stream::unfold(start, |next| async move {
            tokio::time::sleep(Duration::from_millis(20)).await;
            Some((Ok::<_, std::io::Error>(next), vec![b'x']))
        });
        Body::from_stream(bytes)
    };
    let path = bench.begin(10_000).await;
    let headers = [TUS, PIECE, ("upload-offset", "0")];
    let begun = Instant::now();
    bench.call(Method::PATCH, &path, &headers, trickle(vec![b'a'])).await.problem(408);
    assert!(begun.elapsed() < Duration::from_secs(5));
    assert!(bench.offset(&path).await > 0, "what came is kept");
    let form = Form::clip().body();
    let head = form[..form.len() / 2].to_vec();
    bench.call(Method::POST, "/v1/jobs", &[("content-type", Form::TYPE)], trickle(head)).await.problem(408);
    assert_eq!(std::fs::read_dir(bench.store.root().join("tmp")).unwrap().count(), 0);
}

/// Sends a piece's head and a part of its body over a connection of its own, and breaks off. Where the request before was
/// only heard after the look at the offset, the server answers 409 and closes: the next look tells where to go on.
fn break_off(serve: &Serve, path: &str, offset: usize, length: usize, part: &[u8]) {
    let mut connection = TcpStream::connect(serve.url.strip_prefix("http://").unwrap()).unwrap();
    write!(
        connection,
        "PATCH {path} HTTP/1.1\r\nhost: localhost\r\ntus-resumable: 1.0.0\r\nupload-offset: {offset}\r\n\
         content-type: application/offset+octet-stream\r\ncontent-length: {length}\r\n\r\n"
    )
    .unwrap();
    let _ = connection.write_all(part);
}

/// `EFFIGY_TORTURE_UPLOAD_MB` of them, cut at some `EFFIGY_TORTURE_CUTS` random offsets.
#[test]
fn an_upload_survives_cuts_and_restarts() {
    let number = |name: &str, default| std::env::var(name).map_or(default, |text| text.parse::<usize>().unwrap());
    let bytes = number("EFFIGY_TORTURE_UPLOAD_MB", 24) << 20;
    let longest = 2 * bytes / number("EFFIGY_TORTURE_CUTS", 16);
    let mut random = Pcg64Mcg::seed_from_u64(11);
    let mut content = vec![0; bytes];
    random.fill_bytes(&mut content);
    let data = tempfile::tempdir().unwrap();
    let mut serve = Serve::start(data.path(), &["--workers", "0"]);
    let client = blocking_client();
    let begun = client.post(format!("{}/v1/uploads", serve.url)).header(TUS.0, TUS.1).header("upload-length", bytes);
    let path = begun.send().unwrap().headers()["location"].to_str().unwrap().to_string();
    let offset_of = |serve: &Serve| -> usize {
        let told = client.head(format!("{}{path}", serve.url)).header(TUS.0, TUS.1).send().unwrap();
        assert_eq!(told.headers()["upload-length"], bytes.to_string().as_str());
        told.headers()["upload-offset"].to_str().unwrap().parse().unwrap()
    };
    let (mut peak, mut cuts, mut restarts) = (0, 0, 0);
    // The offset that was last told, the ends of the last piece and of all of them, and the bytes that have to be sent again.
    let (mut told, mut sent, mut furthest, mut again, mut most) = (0, 0_usize, 0, 0, 0);
    loop {
        let offset = offset_of(&serve);
        assert!(
            (told..=furthest).contains(&offset),
            "{offset}, not {told} to {furthest}: only the last piece may be lost"
        );
        again += sent.saturating_sub(offset);
        most = most.max(sent.saturating_sub(offset));
        if offset == bytes {
            break;
        }
        let part = random.random_range(1..longest).min(bytes - offset);
        break_off(&serve, &path, offset, bytes - offset, &content[offset..offset + part]);
        (told, sent) = (offset, offset + part);
        furthest = furthest.max(sent);
        cuts += 1;
        peak = peak.max(serve.peak_bytes());
        if random.random_range(0..3) == 0 {
            restarts += 1;
            drop(serve); // SIGKILL
            serve = Serve::start(data.path(), &["--workers", "0"]);
        }
    }
    let id = path.rsplit('/').next().unwrap();
    let mut came = std::fs::File::open(data.path().join("uploads").join(id).join("data")).unwrap();
    let (mut hash, mut buffer) = (Sha256::new(), vec![0; 1 << 20]);
    loop {
        let n = came.read(&mut buffer).unwrap();
        if n == 0 {
            break;
        }
        hash.update(&buffer[..n]);
    }
    assert!(hash.finalize() == Sha256::digest(&content), "the bytes differ");
    assert!(cuts > 8 && restarts > 0, "{cuts} cuts, {restarts} restarts");
    eprintln!(
        "{bytes} bytes in {cuts} pieces, {restarts} kills of the server; its peak memory: {peak} bytes; sent again: {again} \
         bytes, at most {most} of a piece"
    );
    assert!(peak < 96 << 20, "{peak} bytes of memory");
}

#[test]
fn the_webs_own_client_resumes_over_a_kill() {
    let tool = crate::program::tool("the_webs_own_client_resumes_over_a_kill", "tus-client", "upload.mjs");
    let Some(mut tool) = tool else { return };
    let folder = tempfile::tempdir().unwrap();
    let (data, file) = (folder.path().join("data"), folder.path().join("clip"));
    let mut content = vec![0; 6 << 20];
    Pcg64Mcg::seed_from_u64(5).fill_bytes(&mut content);
    std::fs::write(&file, &content).unwrap();
    let serve = Serve::start(&data, &["--workers", "0"]);
    let address = serve.url.strip_prefix("http://").unwrap().to_string();
    let mut client =
        tool.args([&serve.url, file.to_str().unwrap()]).stdout(std::process::Stdio::piped()).spawn().unwrap();
    // The client sends slowly; in the middle the server dies and comes back at the same address.
    let uploads = data.join("uploads");
    let came = || -> u64 {
        let entries = std::fs::read_dir(&uploads).unwrap();
        entries.map(|e| e.unwrap().path().join("data").metadata().map_or(0, |m| m.len())).sum()
    };
    while came() < 2 << 20 {
        assert!(client.try_wait().unwrap().is_none(), "the client ended early");
        std::thread::sleep(Duration::from_millis(5));
    }
    drop(serve);
    let before = came();
    let _serve = Serve::start(&data, &["--workers", "0", "--listen", &address]);
    let mut said = String::new();
    client.stdout.take().unwrap().read_to_string(&mut said).unwrap();
    assert!(client.wait().unwrap().success(), "{said}");
    assert!(before < content.len() as u64, "the server died too late");
    let id = said.trim().rsplit('/').next().unwrap();
    let came = std::fs::read(uploads.join(id).join("data")).unwrap();
    assert!(Sha256::digest(&came) == Sha256::digest(&content), "the bytes differ");
}
