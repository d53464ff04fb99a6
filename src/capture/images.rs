//! Zips of PNG or JPEG images, as a stream of pictures.

use std::io::Cursor;
use std::path::Path;
use std::time::Instant;

use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder, ImageReader};

use super::archive::Archive;
use super::labels::{self, Kind};
use super::limits::{self, IMAGE_BYTES};
use super::source::{Picture, Pixels};
use super::{BadInput, CaptureError, Part, video};

pub(super) struct ImageStream {
    part: Part,
    archive: Archive,
    pixels: Pixels,
    /// Masks are maps of labels.
    labels: bool,
    next: usize,
    deadline: Instant,
}

/// So many masks, spread over a zip, tell whether they are maps of labels.
const LOOKED_AT: usize = 5;

impl ImageStream {
    pub fn open(part: Part, path: &Path, pixels: Pixels, deadline: Instant) -> Result<Self, CaptureError> {
        let archive = Archive::open(part, path, &[".png", ".jpg", ".jpeg"])?;
        if archive.len() > limits::FRAMES {
            return Err(limits::too_many_frames(part).into());
        }
        let mut stream = Self { part, archive, pixels, labels: false, next: 0, deadline };
        if part == Part::Masks {
            stream.labels = stream.holds_labels();
        }
        Ok(stream)
    }

    /// Whether those of some masks that show anything are maps of labels. What cannot be read is told when its turn comes.
    fn holds_labels(&mut self) -> bool {
        let (mut labels, count) = (false, self.archive.len());
        for k in 0..LOOKED_AT.min(count) {
            let Ok(bytes) = self.archive.read(k * count / LOOKED_AT.min(count), IMAGE_BYTES) else { return false };
            match self.image(&bytes).map(|image| Kind::of(&image)) {
                Ok(Kind::Labels) => labels = true,
                Ok(Kind::Black) => {}
                Ok(Kind::Other) | Err(_) => return false,
            }
        }
        labels
    }

    pub fn warnings(&self) -> Vec<String> {
        let part = self.part;
        let ignored = format!("{part}: {} files of the zip are no images and were ignored", self.archive.ignored);
        let labels = format!("{part}: maps of labels, whatever is not black is taken for the person");
        let told = [(self.archive.ignored > 0, ignored), (self.labels, labels)];
        told.into_iter().filter(|(applies, _)| *applies).map(|(_, warning)| warning).collect()
    }

    pub fn ignored(&self) -> usize {
        self.archive.ignored
    }

    pub fn gap(&self) -> Option<u64> {
        self.archive.gap()
    }

    pub fn name(&self, index: usize) -> String {
        self.archive.name(index)
    }

    /// The next picture; decoded only where it is wanted, else its header alone is read.
    pub fn next(&mut self, want: bool) -> Result<Option<Picture>, CaptureError> {
        let index = self.next;
        if index == self.archive.len() {
            return Ok(None);
        }
        if Instant::now() > self.deadline {
            let message = format!("decoding took too long; it stopped after {index} images");
            return Err(BadInput::new(self.part, message, "fewer or smaller images").into());
        }
        self.next += 1;
        let bytes = self.archive.read(index, IMAGE_BYTES)?;
        let picture = self.decode(&bytes, want).map_err(|reason| match reason {
            Reason::Bad(bad) => bad.at(index),
            Reason::Image(e) => {
                let message = format!("`{}` cannot be read: {e}", self.archive.name(index));
                BadInput::new(self.part, message, "a whole PNG or JPEG image").at(index)
            }
        })?;
        Ok(Some(picture))
    }

    fn decode(&self, bytes: &[u8], want: bool) -> Result<Picture, Reason> {
        if !want {
            // What was written half has its header, too. JPEG's decoder takes what is there.
            if bytes.starts_with(PNG_START) && !bytes.windows(PNG_END.len()).rev().any(|end| end == PNG_END) {
                let cut_off = std::io::Error::new(std::io::ErrorKind::UnexpectedEof, "it is cut off");
                return Err(image::ImageError::IoError(cut_off).into());
            }
            let (decoder, orientation) = self.header(bytes)?;
            let (width, height) = decoder.dimensions();
            let (width, height) = if is_quarter_turn(orientation) { (height, width) } else { (width, height) };
            return Ok(Picture { width, height, data: Vec::new() });
        }
        let image = self.image(bytes)?;
        let (width, height) = (image.width(), image.height());
        let data = match self.pixels {
            Pixels::Rgb => image.into_rgb8().into_raw(),
            Pixels::Mask if self.labels => labels::mask(&image),
            Pixels::Mask => matte(&image),
        };
        Ok(Picture { width, height, data })
    }

    /// An image of a size that is allowed, and how it is turned.
    fn header<'a>(&self, bytes: &'a [u8]) -> Result<(impl ImageDecoder + 'a, Orientation), Reason> {
        let reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(image::ImageError::IoError)?;
        let mut decoder = reader.into_decoder()?;
        let (width, height) = decoder.dimensions();
        limits::check_image_size(self.part, width, height)?;
        let orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms);
        Ok((decoder, orientation))
    }

    /// The image, upright.
    fn image(&self, bytes: &[u8]) -> Result<DynamicImage, Reason> {
        let (decoder, orientation) = self.header(bytes)?;
        let mut image = DynamicImage::from_decoder(decoder)?;
        image.apply_orientation(orientation);
        Ok(image)
    }
}

const PNG_START: &[u8] = b"\x89PNG";
/// The last chunk, which has nothing in it, and its checksum.
const PNG_END: &[u8] = b"IEND\xae\x42\x60\x82";

/// Why a picture was refused.
enum Reason {
    Bad(BadInput),
    Image(image::ImageError),
}

impl From<BadInput> for Reason {
    fn from(bad: BadInput) -> Self {
        Reason::Bad(bad)
    }
}

impl From<image::ImageError> for Reason {
    fn from(error: image::ImageError) -> Self {
        Reason::Image(error)
    }
}

fn is_quarter_turn(orientation: Orientation) -> bool {
    use Orientation::{Rotate90, Rotate90FlipH, Rotate270, Rotate270FlipH};
    matches!(orientation, Rotate90 | Rotate270 | Rotate90FlipH | Rotate270FlipH)
}

/// The mask in an image.
fn matte(image: &DynamicImage) -> Vec<u8> {
    match image.color().has_alpha() {
        true => video::matte(image.to_luma_alpha8().as_raw().as_chunks().0),
        false => image.to_luma8().into_raw(),
    }
}

#[cfg(test)]
mod tests {
    use image::{Rgba, RgbaImage};

    use super::*;

    #[test]
    fn alpha_is_the_mask_only_where_there_is_transparency() {
        let cut_out =
            RgbaImage::from_fn(2, 1, |x, _| if x == 0 { Rgba([0, 0, 0, 255]) } else { Rgba([255, 255, 255, 0]) });
        assert_eq!(matte(&DynamicImage::from(cut_out)), [255, 0]);
        let opaque =
            RgbaImage::from_fn(2, 1, |x, _| if x == 0 { Rgba([255, 255, 255, 255]) } else { Rgba([0, 0, 0, 255]) });
        assert_eq!(matte(&DynamicImage::from(opaque)), [255, 0]);
    }
}
