//! Pictures as FFmpeg writes them into a pipe, one after the other.

use std::io::{BufRead, Read};

use crate::capture::child::{Outcome, Output, Tool};
use crate::capture::limits;
use crate::capture::source::Picture;
use crate::capture::{BadInput, CaptureError, Part};
use crate::mask::is_foreground;

/// How the pictures of a stream are laid out.
#[derive(Clone, Copy)]
pub(super) enum Layout {
    Rgb,
    Grey,
    GreyAlpha,
}

impl Layout {
    /// FFmpeg's encoder and pixel format.
    pub fn names(self) -> (&'static str, &'static str) {
        match self {
            Layout::Rgb => ("ppm", "rgb24"),
            Layout::Grey => ("pgm", "gray"),
            Layout::GreyAlpha => ("pam", "ya8"),
        }
    }

    fn channels(self) -> usize {
        match self {
            Layout::Rgb => 3,
            Layout::Grey => 1,
            Layout::GreyAlpha => 2,
        }
    }

    /// The pixels of a [`Picture`].
    fn pixels(self, data: Vec<u8>) -> Vec<u8> {
        match self {
            Layout::Rgb | Layout::Grey => data,
            Layout::GreyAlpha => matte(data.as_chunks().0),
        }
    }
}

/// The mask in luma and alpha: alpha where it leaves out anything (a cut-out person), else luma. Alpha that is not quite opaque
/// leaves out nothing: a lossy codec makes it of 255.
pub(in crate::capture) fn matte(pixels: &[[u8; 2]]) -> Vec<u8> {
    let channel = usize::from(pixels.iter().any(|pixel| !is_foreground(pixel[1])));
    pixels.iter().map(|pixel| pixel[channel]).collect()
}

/// Pictures out of a running FFmpeg.
pub(in crate::capture) struct VideoStream {
    part: Part,
    /// Until the stream has ended.
    running: Option<(Tool, Output)>,
    announced: Option<u32>,
    layout: Layout,
    count: usize,
    damage: Option<String>,
}

impl VideoStream {
    /// Of an FFmpeg that has started to write; `announced` frames are to come, where that is known.
    pub(super) fn new(part: Part, running: (Tool, Output), announced: Option<u32>, layout: Layout) -> Self {
        Self { part, running: Some(running), announced, layout, count: 0, damage: None }
    }

    /// The next picture; its pixels only where they are wanted.
    pub fn next(&mut self, want: bool) -> Result<Option<Picture>, CaptureError> {
        let Some((_, output)) = &mut self.running else { return Ok(None) };
        let Some((width, height)) = read_header(output) else { return self.end() };
        limits::check_image_size(self.part, width, height)?;
        let bytes = width as usize * height as usize * self.layout.channels();
        let mut data = Vec::new();
        let mut body = output.by_ref().take(bytes as u64);
        let read = if want {
            data.reserve_exact(bytes);
            body.read_to_end(&mut data).unwrap_or(0)
        } else {
            std::io::copy(&mut body, &mut std::io::sink()).unwrap_or(0) as usize
        };
        if read < bytes {
            return self.end();
        }
        self.count += 1;
        Ok(Some(Picture { width, height, data: self.layout.pixels(data) }))
    }

    /// What FFmpeg complained of, once the stream has ended.
    pub fn damage(&self) -> Option<&str> {
        self.damage.as_deref()
    }

    fn end(&mut self) -> Result<Option<Picture>, CaptureError> {
        let Some((tool, output)) = self.running.take() else { return Ok(None) };
        let outcome = tool.finish(output)?;
        match self.judge(&outcome) {
            Some(bad) => Err(bad.into()),
            None => {
                self.damage = (!outcome.messages.is_empty()).then(|| outcome.messages.join("; "));
                Ok(None)
            }
        }
    }

    fn judge(&self, outcome: &Outcome) -> Option<BadInput> {
        let (count, because) = (self.count, outcome.because());
        let announced = self.announced.map_or("its".to_owned(), |n| n.to_string());
        if outcome.timed_out {
            let message = format!("decoding took too long; it stopped after {count} frames");
            return Some(BadInput::new(self.part, message, "a shorter or smaller clip"));
        }
        if count == 0 {
            return Some(BadInput::new(self.part, format!("0 frames could be read{because}"), "at least one frame"));
        }
        // Fewer frames than announced are no fault by themselves: edit lists cut frames away.
        let short = self.announced.is_some_and(|n| (count as u32) < n) && !outcome.messages.is_empty();
        if !outcome.success || short {
            let message =
                format!("the file is damaged or cut off: {count} of {announced} frames could be read{because}");
            return Some(BadInput::new(self.part, message, "a whole video file"));
        }
        None
    }
}

/// `P6\nwidth height\n255\n`, or with P7 a line for each of more numbers; `None` at the end of the stream.
fn read_header(reader: &mut impl BufRead) -> Option<(u32, u32)> {
    let mut line = || {
        let mut line = Vec::new();
        reader.by_ref().take(32).read_until(b'\n', &mut line).ok()?;
        String::from_utf8(line).ok()
    };
    if line()?.starts_with("P7") {
        let (mut width, mut height) = (None, None);
        loop {
            let line = line()?;
            match line.trim().split_once(' ') {
                Some(("WIDTH", number)) => width = number.parse().ok(),
                Some(("HEIGHT", number)) => height = number.parse().ok(),
                None if line.starts_with("ENDHDR") => return Some((width?, height?)),
                None => return None,
                Some(_) => {}
            }
        }
    }
    let (size, _maximum) = (line()?, line()?);
    let (width, height) = size.trim().split_once(' ')?;
    Some((width.parse().ok()?, height.parse().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_of_pixmaps() {
        assert_eq!(read_header(&mut &b"P6\n360 640\n255\nxyz"[..]), Some((360, 640)));
        let pam = b"P7\nWIDTH 36\nHEIGHT 64\nDEPTH 2\nMAXVAL 255\nTUPLTYPE GRAYSCALE_ALPHA\nENDHDR\nxyz";
        let mut rest = &pam[..];
        assert_eq!((read_header(&mut rest), rest), (Some((36, 64)), &b"xyz"[..]));
        assert_eq!(read_header(&mut &pam[..40]), None);
        assert_eq!(read_header(&mut &b""[..]), None);
        assert_eq!(read_header(&mut &b"P6\n36"[..]), None);
    }
}
