//! Video files, read by FFmpeg in a child process as a stream of pictures.

use std::io::{BufRead, Read};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::Instant;

use super::child::{Outcome, Output, Tool};
use super::hdr::{self, Colours};
use super::limits::{self, PROBE_TIME};
use super::source::{Picture, Pixels};
use super::{BadInput, CaptureError, Part};

/// Containers that FFmpeg may open. Playlists, concatenations and other formats that name further files are not here.
const FORMATS: &str = "mov,mp4,matroska,webm,avi,mpegts,mpeg,mpegvideo,flv,ogg,asf,ivf,h264,hevc,obu,av1,m4v,mjpeg,\
                       mxf,gif,yuv4mpegpipe,nut,dv,rm";
/// Phones film slow motion with up to 960.
const MOST_FRAMES_A_SECOND: f64 = 960.0;
/// Only the file itself is read.
const PROTOCOLS: &str = "file";

/// A video file whose header FFmpeg understands.
#[derive(Debug)]
pub(super) struct VideoFile {
    part: Part,
    path: PathBuf,
    url: String,
    pub fps: f64,
    /// Number of frames that the container announces, or that follows from its duration.
    announced: Option<u32>,
    /// Of a video that is brought from HDR to sRGB
    hdr: Option<Colours>,
    /// Of masks whose pictures have transparency.
    alpha: Option<Alpha>,
    pub warnings: Vec<String>,
}

#[derive(serde::Deserialize)]
struct Probe {
    #[serde(default)]
    streams: Vec<ProbeStream>,
    #[serde(default)]
    format: ProbeFormat,
}

#[derive(Default, serde::Deserialize)]
#[serde(default)]
struct ProbeFormat {
    duration: Option<String>,
}

#[derive(Default, serde::Deserialize)]
#[serde(default)]
struct ProbeStream {
    width: u32,
    height: u32,
    avg_frame_rate: String,
    r_frame_rate: String,
    nb_frames: Option<String>,
    duration: Option<String>,
    sample_aspect_ratio: String,
    codec_name: String,
    pix_fmt: String,
    tags: ProbeTags,
    #[serde(flatten)]
    colours: Colours,
}

#[derive(Default, serde::Deserialize)]
#[serde(default)]
struct ProbeTags {
    #[serde(alias = "ALPHA_MODE")]
    alpha_mode: String,
}

/// Transparency beside a video's colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Alpha {
    /// In the pictures themselves.
    Stored,
    /// In a second stream of VP8's or VP9's, which this decoder reads and FFmpeg's own does not.
    Beside(&'static str),
}

impl Alpha {
    fn of(stream: &ProbeStream) -> Option<Self> {
        let beside = stream.tags.alpha_mode == "1";
        match stream.codec_name.as_str() {
            "vp8" if beside => return Some(Self::Beside("libvpx")),
            "vp9" if beside => return Some(Self::Beside("libvpx-vp9")),
            _ => {}
        }
        let names = ["yuva", "gbrap", "rgba", "bgra", "argb", "abgr", "ya8", "ya16", "pal8"];
        names.iter().any(|name| stream.pix_fmt.starts_with(name)).then_some(Self::Stored)
    }
}

impl VideoFile {
    /// Reads the header, not the frames.
    pub fn open(part: Part, path: &Path) -> Result<Self, CaptureError> {
        let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        let url = format!("file:{}", path.display());
        let arguments = [
            "-hide_banner",
            "-v",
            "error",
            "-protocol_whitelist",
            PROTOCOLS,
            "-format_whitelist",
            FORMATS,
            "-select_streams",
            "V",
            "-show_streams",
            "-show_format",
            "-of",
            "json",
            &url,
        ];
        let (json, outcome) = run("ffprobe", &arguments, Some(&path), 4 << 20)?;
        let expected = "a video that FFmpeg reads, or a zip of PNG or JPEG images";
        if !outcome.success {
            return Err(BadInput::new(part, format!("this is no readable video{}", outcome.because()), expected).into());
        }
        let probe: Probe = serde_json::from_slice(&json)
            .map_err(|e| CaptureError::internal("the answer of `ffprobe`", std::io::Error::other(e)))?;
        let Some(stream) = probe.streams.first() else {
            return Err(BadInput::new(part, "the file holds no video stream", expected).into());
        };
        limits::check_image_size(part, stream.width, stream.height)?;
        let rate = frame_rate(&stream.avg_frame_rate).or(frame_rate(&stream.r_frame_rate));
        let duration = stream.duration.as_ref().or(probe.format.duration.as_ref()).and_then(|d| d.parse::<f64>().ok());
        let counted = stream.nb_frames.as_ref().and_then(|n| n.parse().ok()).filter(|&n| n > 0);
        let announced = counted.or_else(|| Some((duration? * rate?).round() as u32));
        if announced.is_some_and(|n| n as usize > limits::FRAMES + limits::FRAMES / 10) {
            return Err(limits::too_many_frames(part).into());
        }
        let mut warnings = oddities(stream, rate);
        let mut hdr = (part == Part::Video && stream.colours.are_hdr()).then(|| stream.colours.clone());
        if hdr.is_some() && !maps_hdr()? {
            warnings.push(format!(
                "the video is HDR, and this FFmpeg lacks the filters {} that would map it: its colours are used as \
                 stored and will look flat",
                hdr::FILTERS.map(|name| format!("`{name}`")).join(" or ")
            ));
            hdr = None;
        }
        let alpha = if part == Part::Masks { Alpha::of(stream) } else { None };
        if let Some(Alpha::Beside(decoder)) = alpha
            && !knows("-decoders", &[decoder])?
        {
            let message = format!("the video has transparency that this FFmpeg, without `{decoder}`, cannot read");
            return Err(BadInput::new(part, message, "a black and white video, or a zip of PNG images").into());
        }
        Ok(Self { part, path, url, fps: rate.unwrap_or(30.0), announced, hdr, alpha, warnings })
    }

    /// Whether decoding brings HDR to sRGB.
    pub fn is_hdr(&self) -> bool {
        self.hdr.is_some()
    }

    /// Starts decoding. Every stored frame comes once, turned as its rotation tag says; with `some` only those with these
    /// numbers, which rise. With `fast`, filters that only smooth the picture are left out. HDR comes as sRGB, but for `fast`
    /// and for masks.
    pub fn decode(
        &self,
        pixels: Pixels,
        fast: bool,
        some: Option<&[usize]>,
        deadline: Instant,
    ) -> Result<VideoStream, CaptureError> {
        let layout = match pixels {
            Pixels::Rgb => Layout::Rgb,
            Pixels::Mask if self.alpha.is_some() => Layout::GreyAlpha,
            Pixels::Mask => Layout::Grey,
        };
        let (codec, format) = layout.names();
        let max_pixels = limits::PIXELS.to_string();
        let threads = std::thread::available_parallelism().map_or(1, |n| n.get().min(4)).to_string();
        let skip = if fast { "all" } else { "default" };
        let passthrough = passthrough_option()?;
        let mut filters = "settb=1,setpts=N".to_owned();
        if let Some(frames) = some {
            filters = format!("{filters},select='{}'", is_one_of(frames));
        }
        if let Some(colours) = self.hdr.as_ref().filter(|_| pixels == Pixels::Rgb && !fast) {
            filters = format!("{filters},{}", colours.to_srgb());
        }
        // Portable pixmaps tell the size of each picture in the stream itself, after rotation. Frames are numbered
        // anew, so that odd timestamps neither drop one nor raise complaints.
        #[rustfmt::skip]
        let mut arguments = vec![
            "-hide_banner", "-nostdin", "-v", "error",
            "-protocol_whitelist", PROTOCOLS, "-format_whitelist", FORMATS,
            "-max_pixels", &max_pixels, "-threads", &threads, "-skip_loop_filter", skip,
        ];
        if let Some(Alpha::Beside(decoder)) = self.alpha {
            arguments.extend(["-c:v", decoder]);
        }
        #[rustfmt::skip]
        arguments.extend([
            "-i", &self.url, "-map", "0:V:0", "-an", "-sn", "-dn", "-vf", &filters, passthrough, "passthrough",
            "-sws_flags", "bicubic+accurate_rnd+full_chroma_int+full_chroma_inp",
            "-c:v", codec, "-pix_fmt", format, "-f", "image2pipe", "pipe:1",
        ]);
        let running = Some(Tool::start("ffmpeg", &arguments, Some(&self.path), deadline)?);
        let announced = if some.is_some() { None } else { self.announced };
        Ok(VideoStream { part: self.part, running, announced, layout, count: 0, damage: None })
    }
}

/// FFmpeg's expression for a frame with one of these numbers. FFmpeg takes chains of a hundred sums and no longer ones, but nests them
/// as deeply as this.
fn is_one_of(frames: &[usize]) -> String {
    match frames {
        [] => "0".to_owned(),
        [n] => format!("eq(n,{n})"),
        _ => {
            let (first, second) = frames.split_at(frames.len() / 2);
            format!("({}+{})", is_one_of(first), is_one_of(second))
        }
    }
}

/// How the pictures of a stream are laid out.
#[derive(Clone, Copy)]
enum Layout {
    Rgb,
    Grey,
    GreyAlpha,
}

impl Layout {
    /// FFmpeg's encoder and pixel format.
    fn names(self) -> (&'static str, &'static str) {
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

/// The mask in luma and alpha: alpha where there is any transparency (a cut-out person), else luma.
pub(super) fn matte(pixels: &[[u8; 2]]) -> Vec<u8> {
    let channel = usize::from(pixels.iter().any(|pixel| pixel[1] < u8::MAX));
    pixels.iter().map(|pixel| pixel[channel]).collect()
}

/// Pictures out of a running FFmpeg.
pub(super) struct VideoStream {
    part: Part,
    /// Until the stream has ended.
    running: Option<(Tool, Output)>,
    announced: Option<u32>,
    layout: Layout,
    count: usize,
    damage: Option<String>,
}

impl VideoStream {
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

/// Runs a tool that answers quickly; its output, at most `limit` bytes of it.
fn run(
    name: &'static str,
    arguments: &[&str],
    input: Option<&Path>,
    limit: u64,
) -> Result<(Vec<u8>, Outcome), CaptureError> {
    let (tool, mut output) = Tool::start(name, arguments, input, Instant::now() + PROBE_TIME)?;
    let mut bytes = Vec::new();
    // A broken pipe shows as a failed process.
    let _ = output.by_ref().take(limit).read_to_end(&mut bytes);
    Ok((bytes, tool.finish(output)?))
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

/// Frames a second; `None` also where the container tells the unit of its clock instead, as files of browsers' recorders do.
fn frame_rate(text: &str) -> Option<f64> {
    let (numerator, denominator) = text.split_once('/')?;
    let rate = numerator.parse::<f64>().ok()? / denominator.parse::<f64>().ok()?;
    (rate > 0.0 && rate <= MOST_FRAMES_A_SECOND).then_some(rate)
}

fn oddities(stream: &ProbeStream, rate: Option<f64>) -> Vec<String> {
    let mut warnings = Vec::new();
    if rate.is_none() {
        warnings.push("the file tells no frame rate: 30 a second assumed".to_owned());
    }
    if !matches!(stream.sample_aspect_ratio.as_str(), "" | "1:1" | "0:1" | "N/A") {
        let ratio = &stream.sample_aspect_ratio;
        warnings.push(format!("the pixels are not square ({ratio}): the stored pixels are used as they are"));
    }
    warnings
}

/// How this FFmpeg is told to keep every frame: `-fps_mode` from 5.1 on, `-vsync` before.
fn passthrough_option() -> Result<&'static str, CaptureError> {
    static OPTION: OnceLock<&'static str> = OnceLock::new();
    if let Some(option) = OPTION.get() {
        return Ok(option);
    }
    let (text, _) = run("ffmpeg", &["-version"], None, 1 << 16)?;
    let text = String::from_utf8_lossy(&text).into_owned();
    Ok(OPTION.get_or_init(|| if is_before_5_1(&text) { "-vsync" } else { "-fps_mode" }))
}

/// Whether this FFmpeg has the filters that map HDR to sRGB.
fn maps_hdr() -> Result<bool, CaptureError> {
    static MAPS: OnceLock<bool> = OnceLock::new();
    if let Some(&maps) = MAPS.get() {
        return Ok(maps);
    }
    let maps = knows("-filters", &hdr::FILTERS)?;
    Ok(*MAPS.get_or_init(|| maps))
}

/// Whether all `names` are in a list that FFmpeg prints.
fn knows(list: &str, names: &[&str]) -> Result<bool, CaptureError> {
    let (text, _) = run("ffmpeg", &["-hide_banner", list], None, 1 << 20)?;
    let text = String::from_utf8_lossy(&text);
    let known: Vec<&str> = text.lines().filter_map(|line| line.split_whitespace().nth(1)).collect();
    Ok(names.iter().all(|name| known.contains(name)))
}

/// Builds without a version number (`N-109000-g…`) are taken as recent.
fn is_before_5_1(version_text: &str) -> bool {
    let Some(version) = version_text.strip_prefix("ffmpeg version ") else { return false };
    let mut numbers = version.split(|c: char| !c.is_ascii_digit()).map(str::parse::<u32>);
    match (numbers.next(), numbers.next()) {
        (Some(Ok(major)), Some(Ok(minor))) => (major, minor) < (5, 1),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_are_told_apart() {
        assert!(is_before_5_1("ffmpeg version 4.4.2-0ubuntu0.22.04.1 Copyright"));
        assert!(!is_before_5_1("ffmpeg version 5.1.9-0+deb12u1 Copyright"));
        assert!(!is_before_5_1("ffmpeg version 7.1 Copyright"));
        assert!(!is_before_5_1("ffmpeg version N-109000-g3f1e Copyright"));
    }

    #[test]
    fn a_clocks_unit_is_no_frame_rate() {
        assert_eq!(frame_rate("30000/1001"), Some(30_000.0 / 1001.0));
        assert_eq!(frame_rate("240/1"), Some(240.0));
        for odd in ["1000/1", "90000/1", "0/0", "1/0", "0/1", "30"] {
            assert_eq!(frame_rate(odd), None, "{odd}");
        }
    }

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
