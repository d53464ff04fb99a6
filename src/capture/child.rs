//! FFmpeg as a child process: its output streamed, its time, memory and messages bounded, the rest of the machine out of
//! its reach ([`super::confine`]).

use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, ChildStderr, ChildStdout, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Instant;

use super::CaptureError;
use super::confine::{self, Confinement};
use super::limits::CHILD_MEMORY_BYTES;

/// The standard output of a [`Tool`].
pub(super) type Output = BufReader<ChildStdout>;

/// A running `ffmpeg` or `ffprobe`. Dropping it kills the process.
pub(super) struct Tool {
    name: &'static str,
    child: Arc<Mutex<Child>>,
    stderr: Option<JoinHandle<Vec<String>>>,
    timed_out: Arc<AtomicBool>,
    /// Closed when the process is done, which ends the watchdog.
    watchdog: Option<(Sender<()>, JoinHandle<()>)>,
}

/// How a child process ended.
#[derive(Debug)]
pub(super) struct Outcome {
    pub success: bool,
    pub timed_out: bool,
    /// The first distinct lines of its standard error, without addresses and paths.
    pub messages: Vec<String>,
}

impl Outcome {
    /// The messages as the end of a sentence: `: moov atom not found`, or nothing.
    pub fn because(&self) -> String {
        if self.messages.is_empty() { String::new() } else { format!(": {}", self.messages.join("; ")) }
    }
}

impl Tool {
    /// Starts `name` (found in `PATH`), which may read the file `input`, and returns its standard output beside it. It is
    /// killed at `deadline`.
    pub fn start(
        name: &'static str,
        arguments: &[&str],
        input: Option<&Path>,
        deadline: Instant,
    ) -> Result<(Self, Output), CaptureError> {
        Self::start_confined(name, arguments, input, deadline, Confinement::in_force())
    }

    /// As [`Tool::start`], behind these fences.
    pub fn start_confined(
        name: &'static str,
        arguments: &[&str],
        input: Option<&Path>,
        deadline: Instant,
        confinement: Confinement,
    ) -> Result<(Self, Output), CaptureError> {
        let failed = |error| CaptureError::internal(format!("cannot start `{name}`"), error);
        let program = confine::program(name).ok_or_else(|| failed(std::io::ErrorKind::NotFound.into()))?;
        let mut command = Command::new(&program);
        command.args(arguments).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        // Of this process's environment, which may hold secrets, a decoder needs nothing but the way to its libraries.
        command.env_clear().env("AV_LOG_FORCE_NOCOLOR", "1");
        command.envs(["PATH", "LD_LIBRARY_PATH"].iter().filter_map(|name| Some((name, std::env::var_os(name)?))));
        limit(&mut command);
        confinement.apply(&mut command, &program, input).map_err(failed)?;
        let mut child = command.spawn().map_err(failed)?;
        let (Some(stdout), Some(stderr)) = (child.stdout.take(), child.stderr.take()) else {
            return Err(CaptureError::internal(format!("`{name}`"), std::io::ErrorKind::BrokenPipe.into()));
        };
        let child = Arc::new(Mutex::new(child));
        let timed_out = Arc::new(AtomicBool::new(false));
        let (stop, stopped) = channel::<()>();
        let (watched, flag) = (child.clone(), timed_out.clone());
        let watchdog = std::thread::spawn(move || {
            let left = deadline.saturating_duration_since(Instant::now());
            if stopped.recv_timeout(left) == Err(RecvTimeoutError::Timeout) {
                flag.store(true, Ordering::Relaxed);
                // A process that has just ended cannot be killed, which is as well.
                let _ = watched.lock().unwrap_or_else(PoisonError::into_inner).kill();
            }
        });
        let input = input.map(|path| path.display().to_string());
        let stderr = Some(std::thread::spawn(move || read_messages(stderr, input.as_deref())));
        let tool = Self { name, child, stderr, timed_out, watchdog: Some((stop, watchdog)) };
        Ok((tool, BufReader::with_capacity(1 << 16, stdout)))
    }

    /// Waits for the end of a process whose output has been read as far as it is wanted.
    pub fn finish(mut self, output: Output) -> Result<Outcome, CaptureError> {
        // A process that still writes gets a broken pipe rather than waiting for a reader.
        drop(output);
        // Standard error closes when the process ends, so that the lock below is not held while it still runs.
        let messages = self.stderr.take().and_then(|thread| thread.join().ok()).unwrap_or_default();
        let status = self.child.lock().unwrap_or_else(PoisonError::into_inner).wait();
        let status = status.map_err(|e| CaptureError::internal(format!("`{}`", self.name), e))?;
        Ok(Outcome { success: status.success(), timed_out: self.timed_out.load(Ordering::Relaxed), messages })
    }
}

impl Drop for Tool {
    fn drop(&mut self) {
        {
            let mut child = self.child.lock().unwrap_or_else(PoisonError::into_inner);
            let _ = child.kill();
            let _ = child.wait();
        }
        if let Some((stop, watchdog)) = self.watchdog.take() {
            drop(stop);
            let _ = watchdog.join();
        }
    }
}

/// Bounds what the process may take, where the system has resource limits.
#[cfg(unix)]
fn limit(command: &mut Command) {
    use std::os::unix::process::CommandExt;
    let limits = [(libc::RLIMIT_AS, CHILD_MEMORY_BYTES), (libc::RLIMIT_FSIZE, 0), (libc::RLIMIT_CORE, 0)];
    // SAFETY: between fork and exec only `setrlimit` is called, which is async-signal-safe; nothing is allocated.
    unsafe {
        command.pre_exec(move || {
            for (resource, bytes) in limits {
                let limit = libc::rlimit { rlim_cur: bytes as libc::rlim_t, rlim_max: bytes as libc::rlim_t };
                // A system that refuses a limit (RLIMIT_AS on macOS) still has the others and the deadline.
                libc::setrlimit(resource, &limit);
            }
            Ok(())
        });
    }
}

#[cfg(not(unix))]
fn limit(_command: &mut Command) {}

/// The first distinct lines; the rest is read and dropped so that the process never blocks on it.
fn read_messages(stderr: ChildStderr, input: Option<&str>) -> Vec<String> {
    let mut reader = BufReader::new(stderr);
    let mut messages: Vec<String> = Vec::new();
    let mut line = Vec::new();
    loop {
        line.clear();
        match reader.by_ref().take(4096).read_until(b'\n', &mut line) {
            Ok(0) | Err(_) => return messages,
            Ok(_) if messages.len() < 3 => {
                let message = clean(&String::from_utf8_lossy(&line), input);
                let repeats = message.starts_with("Last message repeated") || messages.contains(&message);
                if !message.is_empty() && !repeats {
                    messages.push(message);
                }
            }
            Ok(_) => {}
        }
    }
}

/// `[h264 @ 0x55fa1d] missing picture` → `missing picture`; `file:/a/b: Invalid data` → `Invalid data`; where the path of
/// `input` is named elsewhere, "the file".
fn clean(line: &str, input: Option<&str>) -> String {
    let mut line = line.trim();
    while let Some((tag, rest)) = line.strip_prefix('[').and_then(|l| l.split_once("] ")) {
        if !tag.contains(" @ ") {
            break;
        }
        line = rest.trim();
    }
    match (line.strip_prefix("file:").and_then(|l| l.rsplit_once(": ")), input) {
        (Some((_, reason)), _) => reason.to_owned(),
        (None, Some(path)) => {
            let named = line.replace(&format!("file:{path}"), "the file").replace(path, "the file");
            named.chars().take(200).collect()
        }
        (None, None) => line.chars().take(200).collect(),
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn messages_lose_addresses_and_paths() {
        let input = Some("/srv/uploads/a");
        for (line, told) in [
            ("[mov,mp4 @ 0x5581] moov atom not found\n", "moov atom not found"),
            ("file:/srv/uploads/a: Invalid data found", "Invalid data found"),
            ("[in#0 @ 0x5581] Error opening input file file:/srv/uploads/a.", "Error opening input file the file."),
            ("Could not find codec parameters in /srv/uploads/a", "Could not find codec parameters in the file"),
            ("[info] stays", "[info] stays"),
        ] {
            assert_eq!(clean(line, input), told);
        }
    }

    #[test]
    fn a_process_that_does_not_end_is_killed_at_its_deadline() {
        let endless = ["-v", "error", "-f", "lavfi", "-i", "testsrc=size=16x16", "-f", "rawvideo", "pipe:1"];
        let deadline = Instant::now() + Duration::from_millis(300);
        let (tool, mut output) = Tool::start("ffmpeg", &endless, None, deadline).unwrap();
        std::io::copy(&mut output, &mut std::io::sink()).unwrap();
        let outcome = tool.finish(output).unwrap();
        assert!(outcome.timed_out && !outcome.success);
    }

    #[test]
    fn a_process_that_is_not_read_to_its_end_is_not_waited_for() {
        let endless = ["-v", "quiet", "-f", "lavfi", "-i", "testsrc=size=640x480", "-f", "rawvideo", "pipe:1"];
        let (tool, output) = Tool::start("ffmpeg", &endless, None, Instant::now() + Duration::from_secs(600)).unwrap();
        assert!(!tool.finish(output).unwrap().timed_out);
    }

    #[test]
    fn a_tool_that_is_missing_is_our_fault() {
        let Err(error) = Tool::start("effigy-no-such-tool", &[], None, Instant::now()) else { panic!("it started") };
        assert!(error.bad_input().is_none());
        assert!(error.to_string().contains("cannot start `effigy-no-such-tool`"), "{error}");
    }
}
