//! What a decoder tries that was taken over: other programs play its part behind the same fences.

use std::io::Read;
use std::net::TcpListener;
use std::path::Path;
use std::time::{Duration, Instant};

use super::super::child::Tool;
use super::*;

/// Runs a program behind the fences; whether it succeeded, and what it wrote to its output and said.
fn run(fences: Confinement, name: &'static str, arguments: &[&str], input: Option<&Path>) -> (bool, String, String) {
    let deadline = Instant::now() + Duration::from_secs(20);
    let (tool, mut output) = Tool::start_confined(name, arguments, input, deadline, fences).unwrap();
    let mut text = String::new();
    output.read_to_string(&mut text).unwrap();
    let outcome = tool.finish(output).unwrap();
    (outcome.success, text, outcome.messages.join("; "))
}

/// What this kernel can raise that has the fence of files, or that of calls, where they are wanted.
fn fences_here(files: bool, calls: bool) -> Vec<Confinement> {
    let here = fences::available();
    let some = [(true, true), (true, false), (false, true)].map(|(files, calls)| Confinement { files, calls });
    let mut found = some.to_vec();
    found.retain(|f| (!f.files || here.files) && (!f.calls || here.calls) && (f.files && files || f.calls && calls));
    if found.is_empty() {
        eprintln!("ignored: this kernel has no such fence");
    }
    found
}

#[test]
fn it_reads_its_input_and_no_other_file() {
    let folder = tempfile::tempdir().unwrap();
    let (input, secret) = (folder.path().join("input"), folder.path().join("secret"));
    std::fs::write(&input, "input").unwrap();
    std::fs::write(&secret, "secret").unwrap();
    for fences in fences_here(true, false) {
        let cat = |path: &Path| run(fences, "cat", &[path.to_str().unwrap()], Some(&input));
        assert_eq!(cat(&input).1, "input");
        for other in [secret.as_path(), Path::new("/etc/passwd"), Path::new("/proc/self/environ")] {
            let (success, read, said) = cat(other);
            assert!(!success && read.is_empty() && said.contains("Permission denied"), "{other:?}: {read}{said}");
        }
        let (success, listed, _) = run(fences, "ls", &[folder.path().to_str().unwrap()], Some(&input));
        assert!(!success && listed.is_empty(), "{listed}");
    }
}

#[test]
fn it_writes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let input = folder.path().join("input");
    std::fs::write(&input, "input").unwrap();
    for fences in fences_here(true, true) {
        for script in ["echo x > new", "echo x >> input", "exec 3<> input", ": > /dev/shm/effigy-confined"] {
            let script = format!("cd {} && {script}", folder.path().display());
            let (success, _, said) = run(fences, "bash", &["-c", &script], Some(&input));
            assert!(!success, "{fences:?}, {script}: {said}");
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        assert_eq!(std::fs::read_to_string(&input).unwrap(), "input");
        assert!(!Path::new("/dev/shm/effigy-confined").exists());
    }
}

#[test]
fn it_reaches_no_host() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    listener.set_nonblocking(true).unwrap();
    let address = listener.local_addr().unwrap();
    let script = format!("exec 3<>/dev/tcp/{}/{}", address.ip(), address.port());
    assert!(run(Confinement::NONE, "bash", &["-c", &script], None).0, "without a fence it can");
    listener.accept().unwrap();
    for fences in fences_here(false, true) {
        let (success, _, said) = run(fences, "bash", &["-c", &script], None);
        assert!(!success && said.contains("not permitted"), "{said}");
        let url = format!("tcp://{address}");
        let called = ["-v", "error", "-f", "lavfi", "-i", "testsrc=d=1", "-f", "nut", &url];
        assert!(!run(fences, "ffmpeg", &called, None).0);
        assert!(listener.accept().is_err(), "it called out");
    }
}

#[test]
fn it_starts_no_process_and_touches_none() {
    for fences in fences_here(false, true) {
        for script in ["( : )", "kill -0 $PPID", "( : ) & wait"] {
            let (success, _, said) = run(fences, "bash", &["-c", script], None);
            assert!(!success && said.contains("not permitted"), "{script}: {said}");
        }
    }
    for fences in fences_here(true, false) {
        let (success, out, said) = run(fences, "bash", &["-c", "exec /bin/echo out"], None);
        assert!(!success && out.is_empty() && said.contains("Permission denied"), "{out}{said}");
    }
}

/// The fences do not show in what is decoded, also with several threads.
#[test]
fn decoding_goes_on_as_without() {
    let folder = tempfile::tempdir().unwrap();
    let clip = folder.path().join("clip.mp4");
    let source = "testsrc=size=64x48:rate=10:duration=1";
    let made = ["-v", "error", "-f", "lavfi", "-i", source, "-c:v", "mpeg4", clip.to_str().unwrap()];
    assert!(Command::new("ffmpeg").args(made).status().unwrap().success());
    let decode = ["-v", "error", "-threads", "4", "-i", clip.to_str().unwrap(), "-f", "framemd5", "pipe:1"];
    let (success, sums, said) = run(Confinement::NONE, "ffmpeg", &decode, Some(&clip));
    assert!(success && sums.lines().count() > 10, "{said}");
    for fences in fences_here(true, true) {
        assert_eq!(run(fences, "ffmpeg", &decode, Some(&clip)), (true, sums.clone(), String::new()), "{fences:?}");
    }
    assert_eq!(Confinement::in_force(), fences::available(), "this FFmpeg runs behind all that the kernel has");
}
