//! Video files, read by FFmpeg in a child process as a stream of pictures.

mod ffmpeg;
mod probe;
mod stream;

use std::path::{Path, PathBuf};
use std::time::Instant;

use self::ffmpeg::{knows, maps_hdr, passthrough_option};
pub(super) use self::probe::PixelShape;
use self::probe::{Alpha, Probe, READABLE, oddities};
use self::stream::Layout;
pub(super) use self::stream::{VideoStream, matte};
use super::child::Tool;
use super::hdr::{self, Colours};
use super::limits;
use super::source::Pixels;
use super::{BadInput, CaptureError, Part};

/// Containers that FFmpeg may open. Playlists, concatenations and other formats that name further files are not here.
const FORMATS: &str = "mov,mp4,matroska,webm,avi,mpegts,mpeg,mpegvideo,flv,ogg,asf,ivf,h264,hevc,obu,av1,m4v,mjpeg,\
                       mxf,gif,yuv4mpegpipe,nut,dv,rm";

/// Only the file itself is read.
const PROTOCOLS: &str = "file";

/// A video file whose header FFmpeg understands.
#[derive(Debug)]
pub(super) struct VideoFile {
    part: Part,
    path: PathBuf,
    url: String,
    pub fps: f64,
    /// Number of frames that the container announces.
    announced: Option<u32>,
    pub pixels: PixelShape,
    /// Of a video that is brought from HDR to sRGB
    hdr: Option<Colours>,
    /// Of masks whose pictures have transparency.
    alpha: Option<Alpha>,
    pub warnings: Vec<String>,
}

impl VideoFile {
    /// Reads the header, not the frames.
    pub fn open(part: Part, path: &Path) -> Result<Self, CaptureError> {
        let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        let url = format!("file:{}", path.display());
        let probe = Probe::of(part, &path, &url)?;
        let Some(stream) = probe.streams.first() else {
            return Err(BadInput::new(part, "the file holds no video stream", READABLE).into());
        };
        limits::check_image_size(part, stream.width, stream.height)?;
        let rate = stream.rate();
        let announced = stream.announced();
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
        let pixels = PixelShape { stored: (stream.width, stream.height), aspect: stream.pixel_aspect().unwrap_or(1.0) };
        Ok(Self { part, path, url, fps: rate.unwrap_or(30.0), announced, pixels, hdr, alpha, warnings })
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
        let running = Tool::start("ffmpeg", &arguments, Some(&self.path), deadline)?;
        let announced = if some.is_some() { None } else { self.announced };
        Ok(VideoStream::new(self.part, running, announced, layout))
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
