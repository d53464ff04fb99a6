//! Answers while the machine is busy: a fit takes every core, status calls come at a fixed rate whether the last was
//! answered or not.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use super::faults::Rig;
use super::resume::{make_clip, upload};
use super::*;

/// For 99 of 100 status calls under a fit.
const QUICK: Duration = Duration::from_millis(50);
/// Tries at it.
const ROUNDS: usize = 8;

fn from_environment(name: &str, default: u64) -> u64 {
    std::env::var(name).map_or(default, |text| text.parse().unwrap())
}

/// Sends `rate` calls a second for so long; their times from the moment when each was due, so that a stalled server
/// cannot hide by delaying the next call.
async fn call_at_rate(url: &str, rate: u64, time: Duration) -> Vec<Duration> {
    let client = client_builder().timeout(Duration::from_secs(10)).build().unwrap();
    let count = (rate as f64 * time.as_secs_f64()) as u32;
    let begun = Instant::now();
    let mut calls = Vec::new();
    for n in 0..count {
        let due = begun + time * n / count;
        tokio::time::sleep_until(due.into()).await;
        let (client, url) = (client.clone(), url.to_string());
        calls.push(tokio::spawn(async move {
            let answer = client.get(url).send().await.unwrap();
            assert_eq!(answer.status(), 200);
            answer.bytes().await.unwrap();
            due.elapsed()
        }));
    }
    let mut times = Vec::new();
    for call in calls {
        times.push(call.await.unwrap());
    }
    times.sort();
    times
}

/// `EFFIGY_TORTURE_CALLS` a second, for `EFFIGY_TORTURE_CALL_SECS`.
#[test]
fn status_calls_are_quick_and_cancels_prompt_under_a_fit() {
    let rate = from_environment("EFFIGY_TORTURE_CALLS", 200);
    let time = Duration::from_secs(from_environment("EFFIGY_TORTURE_CALL_SECS", 2));
    let folder = tempfile::tempdir().unwrap();
    let (clip, data) = (folder.path().join("clip"), folder.path().join("data"));
    // As long a fit as a test can wait for: it is not to end before the calls do.
    let (frames, size_px) = if time.as_secs() > 5 { (120, 256) } else { (12, 96) };
    if !make_clip("status_calls_are_quick_and_cancels_prompt_under_a_fit", &clip, frames, size_px) {
        return;
    }
    let rig = Rig::start(&data, &[], &[]);
    effigy::body::Body::test_body().save(&data.join("bodies/test.body.npz")).unwrap();
    let job = upload(&rig.serve.url, &clip, "paper");
    let job = format!("{}/v1/jobs/{}", rig.serve.url, job["id"].as_str().unwrap());
    rig.until(&job, |job| job["stage"] == "geometry");
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    // The machine's other work must not decide: one round of several has to be good.
    let mut best: Option<Vec<Duration>> = None;
    for _ in 0..ROUNDS {
        let times = runtime.block_on(call_at_rate(&job, rate, time));
        assert_eq!(rig.ask(&job)["state"], "running", "the fit went on meanwhile");
        let p99 = |times: &[Duration]| times[times.len() * 99 / 100];
        if best.as_ref().is_none_or(|best| p99(&times) < p99(best)) {
            best = Some(times);
        }
        if best.as_ref().is_some_and(|best| p99(best) <= QUICK) {
            break;
        }
    }
    let times = best.unwrap();
    let at = |part: usize| times[(times.len() - 1) * part / 1000];
    let wished = Instant::now();
    let cancel = rig.client.post(format!("{job}/cancel")).send().unwrap();
    assert!(cancel.status().is_success());
    rig.until(&job, |job| job["state"] == "canceled");
    eprintln!(
        "{rate} status calls a second under a fit: median {:.1?}, p99 {:.1?}, slowest {:.1?}; canceled {:.1?} after the wish",
        at(500),
        at(990),
        at(1000),
        wished.elapsed()
    );
    assert!(at(990) <= QUICK, "p99 {:?} of {} calls", at(990), times.len());
    // At best 1.4 s; while a fit has all cores that is no bound for a test.
    assert!(wished.elapsed() < Duration::from_secs(10), "{:?}", wished.elapsed());
}

/// A connection that sends a byte a second for as long as it is let.
struct Trickle {
    address: String,
    n: usize,
    connection: std::net::TcpStream,
}

impl Trickle {
    fn open(address: &str, n: usize) -> Trickle {
        let mut connection = std::net::TcpStream::connect(address).unwrap();
        // Half of them stop in the head, half in the body.
        let begun = match n % 2 {
            0 => "GET /v1/jobs HTTP/1.1\r\nhost: localhost\r\nx-slow: ",
            _ => {
                "POST /v1/jobs HTTP/1.1\r\nhost: localhost\r\ncontent-type: multipart/form-data; boundary=b\r\n\
                  content-length: 1000000\r\n\r\n--b\r\n"
            }
        };
        std::io::Write::write_all(&mut connection, begun.as_bytes()).unwrap();
        Trickle { address: address.into(), n, connection }
    }

    /// One byte; true where the server had cut the connection and a new one was opened.
    fn drip(&mut self) -> bool {
        let cut = std::io::Write::write_all(&mut self.connection, b"x").is_err();
        if cut {
            *self = Trickle::open(&self.address, self.n);
        }
        cut
    }
}

/// For `EFFIGY_TORTURE_SLOW_SECS`. Whoever is cut comes back.
#[test]
fn a_thousand_connections_at_a_byte_a_second_do_not_delay_the_others() {
    const CONNECTIONS: usize = 1000;
    let time = Duration::from_secs(from_environment("EFFIGY_TORTURE_SLOW_SECS", 6));
    let data = tempfile::tempdir().unwrap();
    let (serve, client) = super::hostile::start(data.path());
    let posted = client.post(format!("{}/v1/jobs", serve.url)).header("content-type", Form::TYPE);
    let job: Value = posted.body(Form::clip().body()).send().unwrap().json().unwrap();
    let path = format!("{}/v1/jobs/{}", serve.url, job["id"].as_str().unwrap());
    super::hostile::allow_files(2200);
    let address = serve.url.strip_prefix("http://").unwrap();
    let mut slow: Vec<Trickle> = (0..CONNECTIONS).map(|n| Trickle::open(address, n)).collect();
    let (over, cuts, bytes) = (AtomicUsize::new(0), AtomicUsize::new(0), AtomicUsize::new(0));
    let mut rounds = Vec::new();
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while over.load(Ordering::Relaxed) == 0 {
                let next = Instant::now() + Duration::from_secs(1);
                for connection in &mut slow {
                    cuts.fetch_add(usize::from(connection.drip()), Ordering::Relaxed);
                    bytes.fetch_add(1, Ordering::Relaxed);
                }
                std::thread::sleep(next.saturating_duration_since(Instant::now()));
            }
        });
        // The machine's other work must not decide: the best of three rounds counts.
        for _ in 0..3 {
            let (begun, mut times) = (Instant::now(), Vec::new());
            while begun.elapsed() < time / 3 {
                let asked = Instant::now();
                assert_eq!(client.get(&path).send().unwrap().status(), 200);
                times.push(asked.elapsed());
            }
            times.sort();
            rounds.push((times[times.len() * 99 / 100], times.len()));
        }
        over.store(1, Ordering::Relaxed);
    });
    let (p99, calls) = rounds.iter().min().unwrap();
    let (cuts, bytes) = (cuts.into_inner(), bytes.into_inner());
    eprintln!(
        "{CONNECTIONS} connections, {bytes} bytes in {time:?}, {cuts} cuts: p99 {p99:.1?} of {calls} status calls"
    );
    assert!(bytes >= CONNECTIONS * (time.as_secs() as usize / 2), "{bytes} bytes");
    assert!(*p99 < Duration::from_millis(100), "p99 {p99:?}");
}
