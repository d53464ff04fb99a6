//! The program itself: starts, ends, and what lies between.

use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use super::*;
use crate::program;

/// A running `effigy serve`.
pub struct Serve {
    child: Child,
    pub url: String,
}

impl Serve {
    pub fn start(data: &Path, arguments: &[&str]) -> Serve {
        Self::start_with_log(data, arguments, Stdio::null())
    }

    pub fn start_with_log(data: &Path, arguments: &[&str], log: Stdio) -> Serve {
        let mut effigy = program::effigy();
        effigy.args(["serve", "--data-dir"]).arg(data).args(arguments).stderr(log);
        if !arguments.contains(&"--listen") {
            effigy.args(["--listen", "127.0.0.1:0"]);
        }
        Self::spawn(effigy)
    }

    /// With variables for it and its worker.
    pub fn start_with(data: &Path, arguments: &[&str], variables: &[(&str, &str)]) -> Serve {
        let mut effigy = program::effigy();
        effigy.args(["serve", "--listen", "127.0.0.1:0", "--data-dir"]).arg(data).args(arguments);
        effigy.envs(variables.iter().copied()).stderr(Stdio::null());
        Self::spawn(effigy)
    }

    fn spawn(mut effigy: Command) -> Serve {
        let mut child = effigy.stdout(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let url = line.trim().strip_prefix("listening on ").unwrap_or_else(|| panic!("{line:?}")).to_string();
        Serve { child, url }
    }

    pub fn terminate(mut self) -> std::process::ExitStatus {
        // SAFETY: a signal to a child of ours that was not waited for.
        unsafe { libc::kill(self.child.id() as libc::pid_t, libc::SIGTERM) };
        self.child.wait().unwrap()
    }

    /// Kills the worker without warning.
    pub fn kill_worker(&self) {
        let pid = self.child.id();
        let threads = std::fs::read_dir(format!("/proc/{pid}/task")).unwrap();
        let children = threads.filter_map(|t| std::fs::read_to_string(t.unwrap().path().join("children")).ok());
        let worker = children.collect::<String>().split_whitespace().next().unwrap().parse().unwrap();
        // SAFETY: a signal to a child of our child, which has not been waited for.
        unsafe { libc::kill(worker, libc::SIGKILL) };
    }

    /// The most memory that the process has had, in bytes.
    pub fn peak_bytes(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
        line.trim().trim_end_matches(" kB").parse::<u64>().unwrap() << 10
    }
}

impl Drop for Serve {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn a_server_starts_on_its_defaults_and_ends_when_asked() {
    let data = tempfile::tempdir().unwrap();
    let serve = Serve::start(data.path(), &["--workers", "0"]);
    assert_eq!(blocking_client().get(format!("{}/healthz", serve.url)).send().unwrap().text().unwrap(), "ok\n");
    assert!(serve.terminate().success());
}

fn effigy(data: &Path, arguments: &[&str]) -> (bool, String, String) {
    let output = program::effigy().args(arguments).arg("--data-dir").arg(data).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap().trim().to_string();
    (output.status.success(), text(output.stdout), text(output.stderr))
}

#[test]
fn what_others_can_reach_needs_keys() {
    let data = tempfile::tempdir().unwrap();
    let wide = ["serve", "--workers", "0", "--listen", "0.0.0.0:0"];
    let (ok, _, said) = effigy(data.path(), &wide);
    assert!(!ok && said.contains("effigy keys create"), "{said}");

    let (ok, token, _) =
        effigy(data.path(), &["keys", "create", "laptop", "--scopes", "read,write", "--per-minute", "600"]);
    assert!(ok && token.starts_with("effigy_"), "{token}");
    let (ok, _, said) = effigy(data.path(), &["keys", "create", "laptop"]);
    assert!(!ok && said.contains("laptop"), "{said}");
    let (_, list, _) = effigy(data.path(), &["keys", "list"]);
    assert!(list.contains("laptop") && list.contains("600 a minute") && !list.contains(&token), "{list}");

    let serve = Serve::start(data.path(), &["--workers", "0", "--listen", "0.0.0.0:0"]);
    let url = format!("{}/v1/jobs", serve.url.replace("0.0.0.0", "127.0.0.1"));
    let client = blocking_client();
    let ask = || client.get(&url).bearer_auth(&token).send().unwrap().status().as_u16();
    assert_eq!((blocking_client().get(&url).send().unwrap().status().as_u16(), ask()), (401, 200));
    // The server sees at once what another process does to the keys.
    assert!(effigy(data.path(), &["keys", "revoke", "laptop"]).0);
    assert_eq!(ask(), 401);
    drop(serve);
    let _open = Serve::start(data.path(), &["--workers", "0", "--listen", "0.0.0.0:0", "--auth", "open"]);
}

#[test]
fn a_log_for_programs_ties_a_job_to_the_request_that_brought_it() {
    let data = tempfile::tempdir().unwrap();
    std::fs::create_dir(data.path().join("bodies")).unwrap();
    std::fs::write(data.path().join("bodies/default.body.npz"), b"").unwrap();
    let log = data.path().join("log");
    let stderr = std::fs::File::create(&log).unwrap();
    let serve = Serve::start_with_log(data.path(), &["--workers", "0", "--log-format", "json"], stderr.into());
    let client = blocking_client();
    let sent = client
        .post(format!("{}/v1/jobs", serve.url))
        .header("content-type", Form::TYPE)
        .header("x-request-id", "the-request")
        .body(Form::clip().body())
        .send()
        .unwrap();
    assert_eq!(sent.headers()["x-request-id"], "the-request");
    let job: Value = sent.json().unwrap();
    serve.terminate();
    let lines = std::fs::read_to_string(log).unwrap();
    let lines: Vec<Value> = lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let accepted = lines.iter().find(|line| line["message"] == "accepted").unwrap_or_else(|| panic!("{lines:?}"));
    assert_eq!((&accepted["job"], &accepted["level"]), (&job["id"], &json!("INFO")));
    assert_eq!(accepted["spans"][0]["id"], "the-request", "{accepted}");
}

/// Takes one request as a collector does; its body.
fn collect(listener: &std::net::TcpListener) -> Value {
    let (mut connection, _) = listener.accept().unwrap();
    let mut reader = BufReader::new(connection.try_clone().unwrap());
    let (mut line, mut length) = (String::new(), 0);
    reader.read_line(&mut line).unwrap();
    assert!(line.starts_with("POST /v1/traces "), "{line}");
    while line.trim() != "" {
        line.clear();
        reader.read_line(&mut line).unwrap();
        if let Some(value) = line.to_lowercase().strip_prefix("content-length:") {
            length = value.trim().parse().unwrap();
        }
    }
    let mut body = vec![0; length];
    reader.read_exact(&mut body).unwrap();
    std::io::Write::write_all(&mut connection, b"HTTP/1.1 200 OK\r\ncontent-length: 0\r\nconnection: close\r\n\r\n")
        .unwrap();
    serde_json::from_slice(&body).unwrap()
}

#[test]
fn a_collector_gets_the_spans_of_requests() {
    let data = tempfile::tempdir().unwrap();
    let collector = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let endpoint = format!("http://{}", collector.local_addr().unwrap());
    let serve = Serve::start(data.path(), &["--workers", "0", "--log", "error", "--otlp-endpoint", &endpoint]);
    let client = blocking_client();
    let get = client.get(format!("{}/v1/jobs/x", serve.url));
    let get = get.header("traceparent", "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01");
    assert_eq!(get.send().unwrap().status(), 404);
    let told = collect(&collector);
    let resource = &told["resourceSpans"][0];
    assert_eq!(
        resource["resource"]["attributes"][0],
        json!({ "key": "service.name", "value": { "stringValue": "effigy" } })
    );
    let span = &resource["scopeSpans"][0]["spans"][0];
    assert_eq!((&span["name"], &span["kind"]), (&json!("request"), &json!(2)), "{told:#}");
    assert_eq!(
        (span["traceId"].as_str(), span["parentSpanId"].as_str()),
        (Some("0af7651916cd43dd8448eb211c80319c"), Some("b7ad6b7169203331"))
    );
    let attribute = |key: &str| {
        let found = span["attributes"].as_array().unwrap().iter().find(|attribute| attribute["key"] == key);
        found.unwrap_or_else(|| panic!("{key}: {span:#}"))["value"].clone()
    };
    assert_eq!(attribute("http.response.status_code"), json!({ "intValue": "404" }));
    assert_eq!(attribute("url.path"), json!({ "stringValue": "/v1/jobs/x" }));
    // A collector that is gone holds nothing up, and the end sends what is left.
    assert_eq!(client.get(format!("{}/healthz", serve.url)).send().unwrap().status(), 200);
    let last = std::thread::spawn(move || collect(&collector));
    assert!(serve.terminate().success());
    assert_eq!(last.join().unwrap()["resourceSpans"][0]["scopeSpans"][0]["spans"][0]["name"], "request");
}

#[test]
fn a_machine_without_ca_certificates_serves_all_but_webhooks() {
    let data = tempfile::tempdir().unwrap();
    let mut effigy = program::effigy();
    effigy.args(["serve", "--workers", "0", "--listen", "127.0.0.1:0", "--data-dir"]).arg(data.path());
    effigy.env("SSL_CERT_FILE", "/dev/null").env("SSL_CERT_DIR", data.path());
    let serve = Serve::spawn(effigy);
    assert_eq!(blocking_client().get(format!("{}/healthz", serve.url)).send().unwrap().status(), 200);
}

#[test]
fn two_servers_do_not_share_a_folder() {
    let data = tempfile::tempdir().unwrap();
    let _first = Serve::start(data.path(), &["--workers", "0"]);
    let second = program::effigy()
        .args(["serve", "--workers", "0", "--listen", "127.0.0.1:0", "--data-dir"])
        .arg(data.path())
        .output()
        .unwrap();
    assert!(!second.status.success());
    let said = String::from_utf8_lossy(&second.stderr).into_owned();
    assert!(said.contains("another server uses"), "{said}");
}

#[test]
fn a_start_after_a_kill_keeps_jobs_and_removes_what_is_half_written() {
    let data = tempfile::tempdir().unwrap();
    let serve = Serve::start(data.path(), &["--workers", "0"]);
    std::fs::write(data.path().join("bodies/default.body.npz"), b"").unwrap();
    let client = blocking_client();
    let sent =
        client.post(format!("{}/v1/jobs", serve.url)).header("content-type", Form::TYPE).body(Form::clip().body());
    let job: Value = sent.send().unwrap().json().unwrap();
    drop(serve); // SIGKILL
    std::fs::create_dir_all(data.path().join("tmp/upload-half")).unwrap();
    std::fs::create_dir_all(data.path().join("jobs").join(Uuid::new_v4().to_string())).unwrap();

    let serve = Serve::start(data.path(), &["--workers", "0"]);
    let path = format!("{}/v1/jobs/{}", serve.url, job["id"].as_str().unwrap());
    assert_eq!(blocking_client().get(path).send().unwrap().json::<Value>().unwrap()["state"], "queued");
    assert_eq!(std::fs::read_dir(data.path().join("tmp")).unwrap().count(), 0);
    assert_eq!(std::fs::read_dir(data.path().join("jobs")).unwrap().count(), 1);
}

/// Zeros as a part of a form, without holding them.
pub struct Zeros(pub u64);

impl Read for Zeros {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let n = self.0.min(buffer.len() as u64) as usize;
        buffer[..n].fill(0);
        self.0 -= n as u64;
        Ok(n)
    }
}

#[test]
fn a_large_upload_leaves_the_memory_flat() {
    const BYTES: u64 = 192 << 20;
    let data = tempfile::tempdir().unwrap();
    let serve = Serve::start(data.path(), &["--workers", "0"]);
    std::fs::write(data.path().join("bodies/default.body.npz"), b"").unwrap();
    let client = blocking_client_builder().timeout(None).build().unwrap();
    assert!(client.get(format!("{}/healthz", serve.url)).send().unwrap().status().is_success());
    let before = serve.peak_bytes();
    let video = reqwest::blocking::multipart::Part::reader_with_length(Zeros(BYTES), BYTES);
    let mut form = reqwest::blocking::multipart::Form::new().part("video", video);
    for (name, content) in Form::clip().without("video").0 {
        form = form.part(name, reqwest::blocking::multipart::Part::bytes(content));
    }
    let answer = client.post(format!("{}/v1/jobs", serve.url)).multipart(form).send().unwrap();
    assert_eq!(answer.status(), 422);
    assert_eq!(answer.json::<Value>().unwrap()["part"], "video");
    let grown = serve.peak_bytes() - before;
    assert!(grown < 32 << 20, "grew by {grown} bytes");
    assert_eq!(std::fs::read_dir(data.path().join("tmp")).unwrap().count(), 0);
}
