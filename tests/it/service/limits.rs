//! Requests that come again, queues and disks that are full.

use std::time::Duration;

use effigy::http::Pace;
use effigy::jobs::State;

use super::process::Serve;
use super::*;

const KEY: &str = "5f0c8f6e-upload-1";

impl Bench {
    async fn upload_under(&self, key: &str, form: &Form) -> Reply {
        let headers = [("content-type", Form::TYPE), ("idempotency-key", key)];
        self.call(Method::POST, "/v1/jobs", &headers, form.body()).await
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_hundred_posts_under_one_key_are_one_job() {
    let bench = Arc::new(Bench::new().await);
    let posts = (0..100).map(|_| {
        let bench = bench.clone();
        tokio::spawn(async move { bench.upload_under(KEY, &Form::clip()).await })
    });
    let mut replies = Vec::new();
    for post in posts.collect::<Vec<_>>() {
        replies.push(post.await.unwrap());
    }
    let first = String::from_utf8(replies[0].body.clone()).unwrap();
    for reply in &replies {
        assert_eq!((reply.status.as_u16(), std::str::from_utf8(&reply.body).unwrap()), (202, first.as_str()));
        assert_eq!(reply.header("location"), replies[0].header("location"));
    }
    let fresh = replies.iter().filter(|reply| !reply.headers.contains_key("idempotency-replayed")).count();
    assert_eq!(fresh, 1);
    assert_eq!(bench.queue.counts().await.unwrap()[&State::Queued], 1);
    assert_eq!(bench.store.job_folders().unwrap().len(), 1);
    assert_eq!(std::fs::read_dir(bench.store.root().join("tmp")).unwrap().count(), 0);
}

#[tokio::test]
async fn a_key_stands_for_one_request() {
    let bench = Bench::new().await;
    let first = bench.upload_under(KEY, &Form::clip()).await;
    assert_eq!(first.status, 202);
    let path = first.header("location").to_string();
    // Later, and whatever became of the job, the answer is the first.
    bench.post(&format!("{path}/cancel")).await;
    // The order of the parts does not matter, nor does how the options are written.
    let mut turned = Form::clip().with("options", r#"{ "seed": 0 }"#);
    turned.0.reverse();
    let again = bench.upload_under(KEY, &turned).await;
    assert_eq!((again.status.as_u16(), &again.body), (202, &first.body));
    assert_eq!(again.header("idempotency-replayed"), "true");
    bench.call(Method::DELETE, &path, &[], Body::empty()).await;
    assert_eq!(bench.upload_under(KEY, &Form::clip()).await.body, first.body);
    for other in [
        Form::clip().with("options", r#"{"seed": 1}"#),
        Form::clip().with("keypoints", keypoints(FRAMES).to_string() + " "),
        Form::clip().with("camera", "{}"),
    ] {
        let problem = bench.upload_under(KEY, &other).await.problem(422);
        assert_eq!(problem["type"], "urn:effigy:problem:idempotency-key-reused", "{problem}");
    }
    bench.assert_empty();
    // Another key, another job. What is refused is not remembered: the mended request may use the key.
    bench.upload_under("other", &Form::clip().without("masks")).await.problem(400);
    let other = bench.upload_under("other", &Form::clip()).await;
    assert!(other.status == 202 && other.body != first.body);
    bench.upload_under("", &Form::clip()).await.problem(400);
    bench.upload_under(&"k".repeat(256), &Form::clip()).await.problem(400);
}

#[tokio::test]
async fn a_full_queue_refuses_with_429() {
    let policy = Policy { max_queued: 2, ..Policy::default() };
    let bench = Bench::with(Limits::default(), policy, 0, Env::system()).await;
    let first = bench.upload_under(KEY, &Form::clip()).await;
    assert_eq!((first.status.as_u16(), bench.upload(&Form::clip()).await.status.as_u16()), (202, 202));
    let reply = bench.upload(&Form::clip()).await;
    assert!(reply.header("retry-after").parse::<u32>().unwrap() > 0);
    assert_eq!(reply.problem(429)["type"], "urn:effigy:problem:queue-full");
    // The answer to an earlier request needs no place.
    assert_eq!(bench.upload_under(KEY, &Form::clip()).await.body, first.body);
    bench.upload_under("new", &Form::clip()).await.problem(429);
    assert_eq!(std::fs::read_dir(bench.store.root().join("tmp")).unwrap().count(), 0);
    bench.claim().await;
    assert_eq!(bench.upload(&Form::clip()).await.status, 202);
}

#[tokio::test]
async fn a_disk_that_has_but_its_reserve_refuses_with_507() {
    let bench = Bench::with(Limits::default(), Policy::default(), 1 << 60, Env::system()).await;
    let problem = bench.upload(&Form::clip()).await.problem(507);
    assert_eq!(problem["type"], "urn:effigy:problem:disk-full", "{problem}");
    assert!(problem["detail"].as_str().unwrap().contains("1152921504606846976"), "{problem}");
    bench.assert_empty();
}

/// A small disk of its own, for as long as it lives.
pub struct Disk(pub tempfile::TempDir);

impl Disk {
    /// None where the system does not let us mount one.
    pub fn mount(bytes: u64) -> Option<Disk> {
        let folder = tempfile::tempdir().unwrap();
        let mount = std::process::Command::new("mount")
            .args(["-t", "tmpfs", "-o", &format!("size={bytes}"), "tmpfs"])
            .arg(folder.path())
            .output();
        mount.is_ok_and(|done| done.status.success()).then_some(Disk(folder))
    }

    /// Writes until not a byte is left.
    pub fn fill(&self) {
        use std::io::Write;
        let filler = std::fs::File::options().create(true).append(true).open(self.0.path().join("filler"));
        let mut filler = filler.unwrap();
        for size in [1 << 16, 1 << 12, 1] {
            while filler.write_all(&vec![0; size]).is_ok() {}
        }
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        let _ = std::process::Command::new("umount").arg("-l").arg(self.0.path()).status();
    }
}

#[test]
fn a_full_disk_still_answers_and_deletes() {
    let Some(disk) = Disk::mount(48 << 20) else {
        eprintln!("a_full_disk_still_answers_and_deletes: ignored, no disk can be mounted here");
        return;
    };
    let data = disk.0.path();
    let serve = Serve::start(data, &["--workers", "0", "--disk-reserve-bytes", "8388608"]);
    std::fs::write(data.join("bodies/default.body.npz"), b"").unwrap();
    let client = blocking_client();
    let jobs = format!("{}/v1/jobs", serve.url);
    let post = || client.post(&jobs).header("content-type", Form::TYPE).body(Form::clip().body()).send().unwrap();
    let mut ids = Vec::new();
    for _ in 0..3 {
        let job: Value = post().json().unwrap();
        ids.push(job["id"].as_str().unwrap_or_else(|| panic!("{job}")).to_string());
    }
    disk.fill();
    let refused = post();
    assert_eq!(refused.status(), 507, "{}", refused.text().unwrap());
    // A server that ends makes a little room, which is gone before the next one begins.
    assert!(serve.terminate().success());
    disk.fill();
    let log = tempfile::NamedTempFile::new().unwrap();
    let arguments = ["--workers", "0", "--disk-reserve-bytes", "8388608"];
    let serve = Serve::start_with_log(data, &arguments, log.reopen().unwrap().into());
    let said = std::fs::read_to_string(log.path()).unwrap();
    assert!(said.contains("the disk is full"), "{said}");
    let jobs = format!("{}/v1/jobs", serve.url);
    for id in &ids {
        let url = format!("{jobs}/{id}");
        assert_eq!(client.get(&url).send().unwrap().json::<Value>().unwrap()["state"], "queued");
        let deleted = client.delete(&url).send().unwrap();
        assert_eq!(deleted.status(), 204, "{}", deleted.text().unwrap());
        assert!(!data.join("jobs").join(id).exists());
        // What came free is taken again: each deletion has a disk without a byte.
        disk.fill();
    }
    assert_eq!(client.get(&jobs).send().unwrap().json::<Value>().unwrap()["jobs"], json!([]));
    std::fs::remove_file(data.join("filler")).unwrap();
    let sent = client.post(&jobs).header("content-type", Form::TYPE).body(Form::clip().body()).send().unwrap();
    assert_eq!(sent.status(), 202, "{}", sent.text().unwrap());
    assert!(serve.terminate().success());
}

/// Bytes that fill the disk shortly before their end.
struct Filling {
    disk: Arc<Disk>,
    left: u64,
    last: u64,
}

impl std::io::Read for Filling {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let n = self.left.min(buffer.len() as u64).min(1 << 14) as usize;
        if self.left > self.last && self.left - n as u64 <= self.last {
            self.disk.fill();
        }
        buffer[..n].fill(0);
        self.left -= n as u64;
        Ok(n)
    }
}

#[test]
fn a_disk_that_fills_under_an_upload_refuses_it_with_507_and_keeps_what_can_be_resumed() {
    const BYTES: u64 = 8 << 20;
    let Some(disk) = Disk::mount(48 << 20) else {
        eprintln!("a_disk_that_fills_under_an_upload…: ignored, no disk can be mounted here");
        return;
    };
    let disk = Arc::new(disk);
    let data = disk.0.path();
    let serve = Serve::start(data, &["--workers", "0", "--disk-reserve-bytes", "8388608"]);
    std::fs::write(data.join("bodies/default.body.npz"), b"").unwrap();
    let client = blocking_client();
    let jobs = format!("{}/v1/jobs", serve.url);
    let filling = || Filling { disk: disk.clone(), left: BYTES, last: 1 << 16 };
    let empty = || std::fs::remove_file(data.join("filler")).unwrap();

    let video = reqwest::blocking::multipart::Part::reader_with_length(filling(), BYTES);
    let form = reqwest::blocking::multipart::Form::new().part("video", video);
    let refused = client.post(&jobs).multipart(form).send().unwrap();
    let status = refused.status();
    let problem: Value = refused.json().unwrap();
    assert_eq!(status, 507, "{problem}");
    assert!(!problem.to_string().contains(data.to_str().unwrap()), "{problem}");
    empty();
    assert_eq!(std::fs::read_dir(data.join("tmp")).unwrap().count(), 0, "nothing of it stays");

    let tus = ("tus-resumable", "1.0.0");
    let begun = client.post(format!("{}/v1/uploads", serve.url)).header(tus.0, tus.1).header("upload-length", BYTES);
    let upload = format!("{}{}", serve.url, begun.send().unwrap().headers()["location"].to_str().unwrap());
    let offset = || -> u64 {
        let told = client.head(&upload).header(tus.0, tus.1).send().unwrap();
        told.headers()["upload-offset"].to_str().unwrap().parse().unwrap()
    };
    let send = |from: u64, body: reqwest::blocking::Body| {
        let patch = client.patch(&upload).header(tus.0, tus.1).header("upload-offset", from);
        patch.header("content-type", "application/offset+octet-stream").body(body).send()
    };
    // The server does not wait for the rest of the body: the client may still be sending, and then misses the answer.
    if let Ok(refused) = send(0, reqwest::blocking::Body::sized(filling(), BYTES)) {
        assert_eq!(refused.status(), 507, "{}", refused.text().unwrap());
    }
    let came = offset();
    assert!(came < BYTES, "{came}");
    empty();
    assert_eq!(send(came, vec![0; (BYTES - came) as usize].into()).unwrap().status(), 204);
    assert_eq!(offset(), BYTES);
    let uploaded = client.post(&jobs).header("content-type", Form::TYPE).body(Form::clip().body()).send().unwrap();
    assert_eq!(uploaded.status(), 202, "{}", uploaded.text().unwrap());
    assert!(serve.terminate().success());
}

#[tokio::test]
async fn json_that_trickles_is_told_so() {
    let pace = Pace { window: Duration::from_millis(150), bytes: 1000 };
    let bench = Bench::with_limits(Limits { pace, ..Limits::default() }).await;
    let id = Uuid::nil();
    for path in ["/v1/webhooks", "/v1/jobs", &format!("/v1/avatars/{id}/renders"), &format!("/v1/avatars/{id}/links")] {
        let trickle = futures_util::stream::unfold((), |()| async {
            tokio::time::sleep(Duration::from_millis(20)).await;
            Some((Ok::<_, std::io::Error>(" "), ()))
        });
        let headers = [("content-type", "application/json")];
        bench.call(Method::POST, path, &headers, Body::from_stream(trickle)).await.problem(408);
    }
}
