//! A stream of pictures, whether from a video or from a zip of images.

use std::path::Path;
use std::time::Instant;

use super::archive;
use super::images::ImageStream;
use super::video::{PixelShape, VideoFile, VideoStream};
use super::{BadInput, CaptureError, Part, limits};

/// What a picture holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Pixels {
    /// `[height, width, 3]`
    Rgb,
    /// `[height, width]`: luma, alpha where that is the mask, or whether there is a label.
    Mask,
}

/// An image with its pixels, or with none where only its size was wanted.
#[derive(Debug)]
pub(super) struct Picture {
    pub width: u32,
    pub height: u32,
    pub data: Vec<u8>,
}

pub(super) struct Source {
    stream: Stream,
    part: Part,
    /// `None` for a zip of images.
    pub fps: Option<f64>,
    /// `None` for a zip of images.
    pub pixels: Option<PixelShape>,
    pub warnings: Vec<String>,
    pub count: usize,
}

enum Stream {
    Video(Box<VideoStream>),
    Images(Box<ImageStream>),
    /// All frames, of which only the sizes are good, and some of them.
    Some {
        all: Box<VideoStream>,
        some: Box<VideoStream>,
    },
}

impl Source {
    /// Opens a video, or a zip of images, told apart by content.
    pub fn open(part: Part, path: &Path, pixels: Pixels, fast: bool, deadline: Instant) -> Result<Self, CaptureError> {
        if archive::is_zip(path)? {
            let stream = ImageStream::open(part, path, pixels, deadline)?;
            let warnings = stream.warnings();
            return Ok(Self {
                stream: Stream::Images(Box::new(stream)),
                part,
                fps: None,
                pixels: None,
                warnings,
                count: 0,
            });
        }
        let file = VideoFile::open(part, path)?;
        let stream = Stream::Video(Box::new(file.decode(pixels, fast, None, deadline)?));
        Ok(Self::of(&file, part, stream))
    }

    /// Opens the pictures of a clip, of which there should be `count`. Only those with the numbers `kept`, which rise, will be wanted.
    pub fn open_kept(path: &Path, kept: &[usize], count: usize, deadline: Instant) -> Result<Self, CaptureError> {
        let part = Part::Video;
        if archive::is_zip(path)? {
            return Self::open(part, path, Pixels::Rgb, false, deadline);
        }
        let file = VideoFile::open(part, path)?;
        // To bring a frame to sRGB takes several times as long as to decode it twice.
        let stream = if file.is_hdr() && kept.len() < count {
            let all = Box::new(file.decode(Pixels::Mask, true, None, deadline)?);
            Stream::Some { all, some: Box::new(file.decode(Pixels::Rgb, false, Some(kept), deadline)?) }
        } else {
            Stream::Video(Box::new(file.decode(Pixels::Rgb, false, None, deadline)?))
        };
        Ok(Self::of(&file, part, stream))
    }

    fn of(file: &VideoFile, part: Part, stream: Stream) -> Self {
        let warnings = file.warnings.iter().map(|w| format!("{part}: {w}")).collect();
        Self { stream, part, fps: Some(file.fps), pixels: Some(file.pixels), warnings, count: 0 }
    }

    /// The next picture; with its pixels only if they are wanted.
    pub fn next(&mut self, want: bool) -> Result<Option<Picture>, CaptureError> {
        let picture = match &mut self.stream {
            Stream::Video(video) => video.next(want)?,
            Stream::Images(images) => images.next(want)?,
            Stream::Some { all, some } => match all.next(false)? {
                Some(picture) if !want => Some(picture),
                Some(_) => Some(some.next(true)?.ok_or_else(|| {
                    BadInput::new(
                        self.part,
                        "the file is damaged: a second look found fewer frames",
                        "a whole video file",
                    )
                    .at(self.count)
                })?),
                None => None,
            },
        };
        self.count += usize::from(picture.is_some());
        if self.count > limits::FRAMES {
            return Err(limits::too_many_frames(self.part).into());
        }
        Ok(picture)
    }

    /// Files of a zip that are no images.
    pub fn ignored(&self) -> usize {
        match &self.stream {
            Stream::Images(images) => images.ignored(),
            Stream::Video(_) | Stream::Some { .. } => 0,
        }
    }

    /// The first number that the names of a zip's images leave out.
    pub fn gap(&self) -> Option<u64> {
        match &self.stream {
            Stream::Images(images) => images.gap(),
            Stream::Video(_) | Stream::Some { .. } => None,
        }
    }

    /// What is wrong with an image of a zip, with the name of its file.
    pub fn named(&self, index: usize, mut bad: BadInput) -> BadInput {
        if let Stream::Images(images) = &self.stream {
            bad.message = format!("{} (`{}`)", bad.message, images.name(index));
        }
        bad
    }

    /// What the decoder complained of, once the stream has ended.
    pub fn damage(&self) -> Option<&str> {
        match &self.stream {
            Stream::Video(video) | Stream::Some { all: video, .. } => video.damage(),
            Stream::Images(_) => None,
        }
    }
}
