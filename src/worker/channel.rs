//! Renders between server and worker: a JSON object a line, requests on the worker's standard input, answers on its
//! standard output, where the worker also says why it cannot work. The end of the input is the end of the server, and so of the worker.

use std::io::{self, BufRead, Write};
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use tokio::sync::watch;

use super::device_thread::DeviceThread;
use crate::jobs::render::{RenderError, RenderRequest};

#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Request {
    pub id: u64,
    pub request: RenderRequest,
    /// The file to write.
    pub to: PathBuf,
}

/// What the worker says.
#[derive(Debug, Serialize, Deserialize)]
#[serde(untagged)]
pub(super) enum Word {
    Answer(Answer),
    /// Whether it has a device, else why not.
    Device {
        device: Result<(), String>,
    },
}

#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Answer {
    pub id: u64,
    pub result: Result<(), RenderError>,
}

/// The worker's side: passes requests to the device until the input ends. Blocks.
pub fn serve(input: impl BufRead, device: &DeviceThread) -> io::Result<()> {
    for line in input.lines() {
        match serde_json::from_str::<Request>(&line?) {
            Ok(Request { id, request, to }) => {
                device.draw(request, to, move |result| say(&Word::Answer(Answer { id, result })))
            }
            Err(error) => tracing::error!(%error, "a line from the server is no request"),
        }
    }
    Ok(())
}

/// The worker's side: tells the server when the device is no longer to be had, and when it is again.
pub async fn tell(mut trouble: watch::Receiver<Option<String>>) {
    while trouble.changed().await.is_ok() {
        let now = trouble.borrow_and_update().clone();
        say(&Word::Device { device: now.map_or(Ok(()), Err) });
    }
}

fn say(word: &Word) {
    let line = match serde_json::to_string(word) {
        Ok(line) => line,
        Err(error) => return tracing::error!(%error, "a word to the server has no JSON"),
    };
    let mut out = io::stdout().lock();
    if let Err(error) = writeln!(out, "{line}").and_then(|()| out.flush()) {
        // The server is gone; the end of the input tells the rest.
        tracing::warn!(%error, "a word to the server is lost");
    }
}
