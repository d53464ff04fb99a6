//! Renders between server and worker: a JSON object a line, requests on the worker's standard input, answers on its
//! standard output. The end of the input is the end of the server, and so of the worker.

use std::io::{self, BufRead, Write};
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::device_thread::DeviceThread;
use crate::jobs::render::{RenderError, RenderRequest};

#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Request {
    pub id: u64,
    pub request: RenderRequest,
    /// The file to write.
    pub to: PathBuf,
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
            Ok(Request { id, request, to }) => device.draw(request, to, move |result| answer(&Answer { id, result })),
            Err(error) => tracing::error!(%error, "a line from the server is no request"),
        }
    }
    Ok(())
}

fn answer(answer: &Answer) {
    let line = match serde_json::to_string(answer) {
        Ok(line) => line,
        Err(error) => return tracing::error!(%error, "an answer has no JSON"),
    };
    let mut out = io::stdout().lock();
    if let Err(error) = writeln!(out, "{line}").and_then(|()| out.flush()) {
        // The server is gone; the end of the input tells the rest.
        tracing::warn!(%error, "an answer is lost");
    }
}
