//! Detail: the last passes of the texture, at the resolution of the uploaded pictures.
//!
//! A fit looks at pictures that are scaled down: shape and poses gain little by more pixels and cost as many times more. A
//! face, a print or a seam shows what it is in the uploaded ones. So in the end the texture alone goes on with these, in some of
//! the frames. Half of them are close-ups of the head, since a whole picture gives a face few of the pixels that a step looks at.
//!
//! Small pictures are enlarged first. Between the places that pixels of few frames hit a texture shows whatever it likes, as specks and
//! lines on a face; an enlarged picture says there what lies between its pixels.

use image::imageops::FilterType::CatmullRom;
use image::imageops::resize;
use image::{GrayImage, RgbImage};

use super::config::FitConfig;
use super::look::well_inside;
use super::state::{FitState, Stage};
use crate::body::joints::HEAD;
use crate::body::{Body, N_POSE};
use crate::camera::Camera;
use crate::capture::{Capture, Frame};
use crate::mask::{self, is_foreground};
use crate::ops::project::cpu::forward as project;
use crate::ops::skinning::cpu::forward as pose_body;

/// Frames at most: a turn in steps of nine degrees.
const FRAMES: usize = 40;
/// What the longer side of a person's crop has at most, pixels.
const MOST_PX: f64 = 1600.0;
/// Uploaded pictures of less than this many times the fit's resolution are not read again, larger ones of no use.
const LEAST_GAIN: f64 = 1.25;
/// Pictures in which the person has no more than this part of [`MOST_PX`] are enlarged by this.
const ENLARGED: u32 = 2;
/// Room around the head, over its size.
const MARGIN: f32 = 1.1;
/// Entries of a level of the texture, as a power of two: the more, the fewer places share one.
const LOG2_HASHMAP_SIZE: u32 = 17;
/// Colours run over a mask's border by compression, pixels.
const BLEEDING_PX: u32 = 2;

/// Which frames are looked at once more, and how large.
#[derive(Clone, Debug, PartialEq)]
pub struct Closer {
    /// Of the fit's frames.
    kept: Vec<usize>,
    /// Their numbers in the video.
    pub frames: Vec<u32>,
    /// The longer side of the whole picture, pixels.
    pub side_px: u32,
    /// Pixels over those of the fit, along a side; one where the fit's own pictures are looked at again.
    pub gain: f64,
    /// How many times larger each picture is made.
    enlarged: u32,
}

impl Closer {
    /// `None` where there is nothing larger and nothing to enlarge.
    pub fn to(capture: &Capture) -> Option<Self> {
        let side = f64::from(capture.camera.width.max(capture.camera.height));
        let person = f64::from(capture.frames.iter().map(|frame| frame.width.max(frame.height)).max()?.max(1));
        let larger = (f64::from(capture.uploaded_side_px) / side).min(MOST_PX / person);
        let gain = if larger < LEAST_GAIN { 1.0 } else { larger };
        let enlarged = if person * gain * f64::from(ENLARGED) <= MOST_PX { ENLARGED } else { 1 };
        if gain * f64::from(enlarged) < LEAST_GAIN {
            return None;
        }
        let (all, n) = (capture.frames.len(), capture.frames.len().min(FRAMES));
        let kept: Vec<usize> = (0..n).map(|i| i * all / n).collect();
        let frames = kept.iter().map(|&k| capture.frames[k].index).collect();
        Some(Self { kept, frames, side_px: (side * gain).round() as u32, gain, enlarged })
    }

    /// Steps after a fit with `config`, if each frame has its close-up.
    pub fn steps(&self, config: &FitConfig) -> u32 {
        let detailed = config.clone().detailed();
        detailed.steps(&detailed.texture.phases, 2 * self.kept.len())
    }

    /// The fit's own pictures of the frames, where there are no larger ones.
    pub fn own(&self, capture: &Capture) -> Option<Capture> {
        (self.gain == 1.0).then(|| Capture {
            camera: capture.camera.clone(),
            uploaded_side_px: capture.uploaded_side_px,
            camera_estimated: capture.camera_estimated,
            fps: capture.fps,
            frames: self.of(&capture.frames),
            keypoint_format: capture.keypoint_format.clone(),
            given_keypoint_format: capture.given_keypoint_format.clone(),
            poses: None,
            warnings: Vec::new(),
        })
    }

    /// Values a frame of the fit, for the frames that are looked at.
    pub fn of<T: Clone>(&self, values: &[T]) -> Vec<T> {
        self.kept.iter().filter_map(|&k| values.get(k).cloned()).collect()
    }
}

/// The texture's way on: a fit of its own, in which all else stands.
pub struct Detail {
    /// Each frame whole, and then its head.
    pub capture: Capture,
    pub camera: Camera,
    pub config: FitConfig,
    /// `[capture's frames]`: of the fit's.
    frames: Vec<usize>,
}

impl Detail {
    /// `fitted` is where a fit of `capture` with `config`, seen by `camera`, has ended; `large` has the frames of `closer`. A frame
    /// that is missing there is left out.
    pub fn new(
        body: &Body,
        capture: &Capture,
        camera: &Camera,
        config: &FitConfig,
        fitted: &FitState,
        closer: &Closer,
        large: Capture,
    ) -> Self {
        // Whatever focal length came with the clip: the fit's own may have taken its place.
        let size = [large.camera.width, large.camera.height].map(|side| side * closer.enlarged);
        let camera = camera.scaled(size[0], size[1]);
        let mut frames = Vec::new();
        let mut pictures = Vec::new();
        for picture in &large.frames {
            let Some(&k) = closer.kept.iter().find(|&&k| capture.frames[k].index == picture.index) else { continue };
            let mut picture = enlarge(picture, closer.enlarged);
            shrink(&mut picture, BLEEDING_PX);
            if let Some(head) = head(body, fitted, k, &camera).and_then(|square| cut(&picture, square)) {
                frames.push(k);
                pictures.push(head);
            }
            frames.push(k);
            pictures.push(picture);
        }
        let mut config = config.clone().detailed();
        config.field = config.field.refined(cell(body, fitted, &camera), LOG2_HASHMAP_SIZE);
        Self {
            capture: Capture { frames: pictures, camera: camera.clone(), poses: None, ..large },
            camera,
            config,
            frames,
        }
    }

    /// The whole pictures, each with its frame of the fit.
    pub fn whole(&self) -> impl Iterator<Item = (usize, &Frame)> {
        let pictures = self.frames.iter().copied().zip(&self.capture.frames);
        // A frame's last one.
        let next = self.frames.iter().skip(1).map(Some).chain([None]);
        pictures.zip(next).filter(|((k, _), next)| *next != Some(k)).map(|(picture, _)| picture)
    }

    /// What the detail starts from; `before` are the sizes of the texture of `fitted`.
    pub fn start(&self, fitted: &FitState, before: &FitConfig) -> FitState {
        let of = |values: &[f32], stride: usize| -> Vec<f32> {
            self.frames.iter().flat_map(|&k| values[k * stride..][..stride].iter().copied()).collect()
        };
        FitState {
            stage: Stage::Texture,
            step: 0,
            poses: of(&fitted.poses, N_POSE),
            stage_poses: of(&fitted.stage_poses, N_POSE),
            stage_transl: of(&fitted.stage_transl, 3),
            transl: of(&fitted.transl, 3),
            run_transl: Vec::new(),
            progress: None,
            field: fitted.field.refined(&before.field, &self.config.field, self.config.seed),
            ..fitted.clone()
        }
    }

    /// `fitted` with the look of `detailed`.
    pub fn end(fitted: FitState, detailed: FitState) -> FitState {
        let FitState { poses, stage_poses, transl, stage_transl, .. } = fitted;
        FitState { poses, stage_poses, transl, stage_transl, ..detailed }
    }
}

/// A pixel at the person, in the units of the texture's coordinates.
fn cell(body: &Body, fitted: &FitState, camera: &Camera) -> f64 {
    let distances = fitted.transl.as_chunks::<3>().0.iter().map(|t| camera.view(t.map(f64::from))[2]);
    let nearest = distances.fold(f64::INFINITY, f64::min);
    nearest.max(0.1) / camera.fx / super::state::cube_side(body)
}

/// The square round the head in frame `k`: left, top, side, pixels of the whole picture.
fn head(body: &Body, fitted: &FitState, k: usize, camera: &Camera) -> Option<[f32; 3]> {
    let (pose, offsets) = (&fitted.poses[k * N_POSE..][..N_POSE], fitted.offsets.as_chunks().0);
    let posed = pose_body(body, &fitted.betas, Some(offsets), pose, fitted.transl.as_chunks().0[k]);
    square_around(camera, &posed.vertices, |v| body.weight_of(v, |j| j as usize == HEAD) > 0.5, MARGIN)
}

/// The square around the vertices of which `part` holds as the camera sees them, `margin` times as large as they need: left, top,
/// side; pixels of the whole image. `None` where none of them is before the camera.
pub fn square_around(
    camera: &Camera,
    vertices: &[[f32; 3]],
    part: impl Fn(usize) -> bool,
    margin: f32,
) -> Option<[f32; 3]> {
    let (view, screen) = project(camera, vertices);
    let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
    for v in (0..view.len()).filter(|&v| view[v][2] > 0.1 && part(v)) {
        (0..2).for_each(|i| (low[i], high[i]) = (low[i].min(screen[v][i]), high[i].max(screen[v][i])));
    }
    let side = margin * (high[0] - low[0]).max(high[1] - low[1]);
    side.is_finite().then(|| [0.5 * (low[0] + high[0] - side), 0.5 * (low[1] + high[1] - side), side])
}

/// The part of a picture in a square of the whole one; `None` where nothing of the person is in it.
fn cut(picture: &Frame, [left, top, side]: [f32; 3]) -> Option<Frame> {
    let within = |low: f32, start: u32, size: u32| {
        let end = (low + side).ceil().clamp(start as f32, (start + size) as f32) as u32;
        let low = low.floor().clamp(start as f32, (start + size) as f32) as u32;
        (low - start, end - low)
    };
    let (x, width) = within(left, picture.x0, picture.width);
    let (y, height) = within(top, picture.y0, picture.height);
    let rows = |values: &[u8], channels: usize| -> Vec<u8> {
        let row = |r: u32| {
            let from = (r * picture.width + x) as usize * channels;
            &values[from..from + width as usize * channels]
        };
        (y..y + height).flat_map(row).copied().collect()
    };
    let mask = rows(&picture.mask, 1);
    let some = mask.iter().any(|&m| is_foreground(m));
    some.then(|| Frame {
        x0: picture.x0 + x,
        y0: picture.y0 + y,
        width,
        height,
        rgb: rows(&picture.rgb, 3),
        mask,
        keypoints: picture.keypoints.clone(),
        ..*picture
    })
}

/// A picture with `times` as many pixels along each side; a mask's border lies where it lay.
fn enlarge(picture: &Frame, times: u32) -> Frame {
    if times == 1 {
        return picture.clone();
    }
    let [x0, y0, width, height] = [picture.x0, picture.y0, picture.width, picture.height].map(|px| px * times);
    let (from, to) = ((picture.width, picture.height), (width, height));
    let rgb = RgbImage::from_raw(from.0, from.1, picture.rgb.clone()).map(|rgb| resize(&rgb, to.0, to.1, CatmullRom));
    let mask =
        GrayImage::from_raw(from.0, from.1, picture.mask.clone()).map(|mask| resize(&mask, to.0, to.1, CatmullRom));
    let (rgb, mask) = (rgb.unwrap_or_default().into_raw(), mask.unwrap_or_default().into_raw());
    let mask = mask.into_iter().map(mask::binary).collect();
    Frame { x0, y0, width, height, rgb, mask, keypoints: picture.keypoints.clone(), ..*picture }
}

/// Takes the outermost pixels off a picture's mask.
fn shrink(picture: &mut Frame, pixels: u32) {
    for _ in 0..pixels {
        let before: Vec<[u8; 4]> = picture.mask.iter().map(|&mask| [0, 0, 0, mask]).collect();
        let inside = well_inside(&before, picture.width as usize);
        picture.mask = inside.map(|inside| if inside { 255 } else { 0 }).collect();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ops::texture_field::TextureFieldConfig;

    fn picture(index: u32, [x0, y0, width, height]: [u32; 4]) -> Frame {
        let n = (width * height) as usize;
        let rgb = (0..n).flat_map(|i| [i as u8, index as u8, 7]).collect();
        Frame { index, x0, y0, width, height, rgb, mask: vec![255; n], keypoints: Vec::new() }
    }

    fn capture(n: u32, side: u32, uploaded_side_px: u32, person: u32) -> Capture {
        Capture {
            camera: Camera::pinhole(side, side, [1.2, 1.2, 0.5, 0.5].map(|part| part * f64::from(side))),
            uploaded_side_px,
            camera_estimated: false,
            fps: 30.0,
            frames: (0..n).map(|i| picture(2 * i, [10, 20, person / 3, person])).collect(),
            keypoint_format: "coco17".into(),
            given_keypoint_format: "coco17".into(),
            poses: None,
            warnings: Vec::new(),
        }
    }

    #[test]
    fn larger_pictures_are_looked_at_in_some_frames_and_up_to_a_size() {
        assert_eq!(Closer::to(&capture(60, 1080, 1080, 900)), None);
        assert_eq!(Closer::to(&capture(60, 1080, 1300, 900)), None, "hardly larger");
        let small = Closer::to(&capture(60, 360, 440, 300)).unwrap();
        assert_eq!((small.side_px, small.gain, small.enlarged), (360, 1.0, 2));
        let own = small.own(&capture(60, 360, 440, 300)).unwrap();
        assert_eq!(own.frames.iter().map(|frame| frame.index).collect::<Vec<_>>(), small.frames);
        let closer = Closer::to(&capture(120, 720, 1920, 500)).unwrap();
        assert_eq!((closer.side_px, closer.frames.len(), closer.enlarged), (1920, FRAMES, 1));
        assert!(closer.own(&capture(120, 720, 1920, 500)).is_none(), "there are larger ones");
        assert_eq!(closer.frames[..3], [0, 6, 12], "every third, at two frames of the video each");
        assert_eq!(closer.of(&(0..120).collect::<Vec<_>>())[..3], [0, 3, 6]);
        let closer = Closer::to(&capture(8, 720, 3840, 640)).unwrap();
        assert_eq!((closer.side_px, closer.gain, closer.frames.len()), (1800, 2.5, 8), "the person has 1600 pixels");
    }

    #[test]
    fn a_square_is_cut_where_the_picture_has_pixels() {
        let picture = picture(5, [10, 20, 6, 8]);
        let cut = |square| cut(&picture, square);
        let part = cut([11.2, 21.0, 2.5]).unwrap();
        assert_eq!((part.x0, part.y0, part.width, part.height, part.index), (11, 21, 3, 3, 5));
        assert_eq!(part.rgb[..3], picture.rgb[3 * 7..][..3]);
        assert_eq!(part.mask, [255; 9]);
        let corner = cut([4.0, 14.0, 8.0]).unwrap();
        assert_eq!((corner.x0, corner.y0, corner.width, corner.height), (10, 20, 2, 2));
        assert!(cut([100.0, 100.0, 5.0]).is_none());
    }

    #[test]
    fn an_enlarged_picture_shows_the_same_at_the_same_place() {
        let mut picture = picture(3, [10, 20, 6, 8]);
        picture.rgb = (0..6 * 8).flat_map(|i| [20 * (i % 6) as u8, 10 * (i / 6) as u8, 7]).collect();
        picture.mask = (0..6 * 8).map(|i| if i % 6 < 3 { 255 } else { 0 }).collect();
        let large = enlarge(&picture, 2);
        assert_eq!((large.x0, large.y0, large.width, large.height, large.index), (20, 40, 12, 16, 3));
        // A ramp goes on between the pixels, whose centres lie at 0.5, 1.5, … and now at 0.25, 0.75, …
        let at = |x: usize, y: usize, channel: usize| i32::from(large.rgb[3 * (y * 12 + x) + channel]);
        assert!((at(5, 6, 0) - 45).abs() <= 1 && (at(6, 6, 0) - 55).abs() <= 1, "{} {}", at(5, 6, 0), at(6, 6, 0));
        assert!((at(5, 7, 1) - 33).abs() <= 1, "{}", at(5, 7, 1));
        assert!((0..12 * 16).all(|i| (large.mask[i] == 255) == (i % 12 < 6)));
    }

    #[test]
    fn masks_shrink_all_round() {
        let mut picture = picture(0, [0, 0, 7, 6]);
        shrink(&mut picture, BLEEDING_PX);
        let inside: Vec<usize> = (0..42).filter(|&i| picture.mask[i] == 255).collect();
        assert_eq!(inside, [16, 17, 18, 23, 24, 25]);
    }

    #[test]
    fn the_texture_goes_on_with_the_heads_of_the_frames_and_all_else_stands() {
        let body = Body::test_body();
        let capture = capture(3, 120, 240, 90);
        let config =
            FitConfig { field: TextureFieldConfig { n_levels: 3, ..Default::default() }, ..FitConfig::draft(1) };
        let poses: Vec<[f32; N_POSE]> =
            (0..3).map(|k| std::array::from_fn(|i| if i == 1 { 0.1 * k as f32 } else { 0.0 })).collect();
        // The camera's y points down: upside down, and in the middle of the picture.
        let transl = [[0.0, 0.0, 2.0]; 3];
        let mut fitted = FitState::new(&body, vec![0.0; body.n_betas], &poses, &transl, config.field, 1);
        fitted.run_transl = fitted.transl.clone();
        let closer = Closer::to(&capture).unwrap();
        let mut large = self::capture(3, 240, 240, 200);
        large.frames.remove(1);
        large.frames.iter_mut().for_each(|frame| *frame = picture(frame.index, [0, 0, 240, 240]));
        // The clip came with another focal length than the one that was found.
        large.camera = Camera { fx: 0.7 * large.camera.fx, fy: 0.7 * large.camera.fy, ..large.camera };
        let found = Camera { cx: 61.0, translation: [0.1, 0.0, 0.0], ..capture.camera.clone() };
        let detail = Detail::new(&body, &capture, &found, &config, &fitted, &closer, large);
        assert_eq!(detail.camera, found.scaled(480, 480));
        assert_eq!(detail.frames, [0, 0, 2, 2], "the second frame could not be read again");
        let whole: Vec<(usize, u32)> = detail.whole().map(|(k, frame)| (k, frame.width)).collect();
        assert_eq!(whole, [(0, 480), (2, 480)], "enlarged");
        let sizes: Vec<u32> = detail.capture.frames.iter().map(|frame| frame.width).collect();
        assert!(sizes[0] < 240 && sizes[1] == 480, "a head before each whole picture: {sizes:?}");
        assert!(detail.config.field.n_levels > 3 && detail.config.field.log2_hashmap_size == LOG2_HASHMAP_SIZE);
        let start = detail.start(&fitted, &config);
        assert_eq!((start.n_frames(), start.stage), (4, Stage::Texture));
        assert!(start.run_transl.is_empty(), "a run of its own");
        assert_eq!((start.poses[1], start.poses[2 * N_POSE + 1]), (0.0, 0.2));
        start.field.validate(&detail.config.field).unwrap();
        let end =
            Detail::end(fitted.clone(), FitState { face_colours: vec![0.25; fitted.face_colours.len()], ..start });
        assert_eq!((end.poses, end.transl), (fitted.poses, fitted.transl));
        assert_eq!(end.face_colours[0], 0.25);
    }
}
