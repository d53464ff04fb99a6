//! What the clip's own frames tell, before anything is fitted.

use serde::Serialize;

use super::flag::{Flag, Kind};
use super::mask::Mask;
use super::mask_edge::{self, edge_offset};
use super::sharpness::sharpness;
use crate::capture::{Capture, Frame};
use crate::keypoints::{Keypoint, points_of};
use crate::math::median;

/// A point further from the mask than this part of the person's height belongs to something else: detectors miss by less.
const OFF_MASK: f64 = 0.04;
/// Confidence of a point that counts as off the mask, and of one that counts as seen.
const SURE: f32 = 0.5;
const SEEN: f32 = 0.2;
/// Of the twelve points of limbs: with fewer, a frame's pose is mostly guessed.
const LIMBS_NEEDED: usize = 8;
/// Pixels along a border before the person counts as cut.
const CUT_PX: usize = 3;
/// A second piece of foreground, of the person's area.
const BLOB: f64 = 0.01;
/// A mask's change from frame to frame, of its area.
const JUMP: f64 = 0.035;
/// With fewer frames a turn, arms that pass the outline change the area as much from frame to frame.
const FRAMES_FOR_JUMPS: usize = 48;
/// A frame's sharpness along rows or columns, of the clip's median there.
const BLURRED: f64 = 0.6;
/// The clip's median sharpness.
const BLURRED_CLIP: f64 = 0.16;
/// Frames that are kept.
const FEW_FRAMES: usize = 20;
/// The person's height, where texture and outline begin to suffer.
const LOW_PX: f64 = 160.0;

/// What was measured in a frame.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FrameMeasures {
    /// Of the video.
    pub frame: u32,
    pub mask_area_px: usize,
    pub height_px: usize,
    /// Area of the second largest part of the mask over that of the largest.
    pub second_blob: f64,
    /// Foreground pixels on the picture's top, bottom, left and right border.
    pub border_px: [usize; 4],
    /// See [`Sharpness::least`](super::sharpness::Sharpness::least); `None` where it cannot be told.
    pub sharpness: Option<f64>,
    /// Along rows and along columns, see [`Sharpness::along`](super::sharpness::Sharpness::along).
    pub sharpness_along: [Option<f64>; 2],
    /// Pixels from the mask's edge outwards to that of the person in the picture; `None` where it cannot be told.
    pub edge_offset_px: Option<f64>,
    /// Points of shoulders, elbows, wrists, hips, knees and ankles that were detected, of 12.
    pub limbs_seen: usize,
    /// Confident points away from the mask.
    pub points_off_mask: usize,
}

/// Measures all frames. `capture` holds the keypoints as they were given.
pub fn measure(capture: &Capture) -> Vec<FrameMeasures> {
    capture.frames.iter().map(|frame| measure_frame(capture, frame)).collect()
}

/// `[N]`: see [`FrameMeasures::edge_offset_px`].
pub fn edge_offsets(measures: &[FrameMeasures]) -> Vec<Option<f64>> {
    measures.iter().map(|m| m.edge_offset_px).collect()
}

fn measure_frame(capture: &Capture, frame: &Frame) -> FrameMeasures {
    let (width, height) = (frame.width as usize, frame.height as usize);
    let mask = Mask { width, height, data: &frame.mask };
    let parts = mask.parts();
    let height_px = mask.height_px();
    let off = |p: &&[f32; 3]| {
        let (x, y) = (f64::from(p[0]) - f64::from(frame.x0), f64::from(p[1]) - f64::from(frame.y0));
        p[2] >= SURE && !mask.is_near(x, y, OFF_MASK * height_px as f64)
    };
    let points = points_of(&capture.keypoint_format).unwrap_or_default();
    let seen = |((part, _), [_, _, confidence]): (&Keypoint, &[f32; 3])| part.is_of_limb() && *confidence >= SEEN;
    let sharp = sharpness(width, height, &frame.rgb, &frame.mask);
    FrameMeasures {
        frame: frame.index,
        mask_area_px: mask.area(),
        height_px,
        second_blob: parts.get(1).map_or(0.0, |&second| second as f64 / parts[0] as f64),
        border_px: border(capture, frame, &mask),
        sharpness: sharp.and_then(|sharp| sharp.least),
        sharpness_along: sharp.map_or([None; 2], |sharp| sharp.along),
        edge_offset_px: edge_offset(frame, height_px),
        limbs_seen: points.iter().zip(&frame.keypoints).filter(|point| seen(*point)).count(),
        points_off_mask: frame.keypoints.iter().filter(off).count(),
    }
}

fn border(capture: &Capture, frame: &Frame, mask: &Mask<'_>) -> [usize; 4] {
    let (right, bottom) = (mask.width as i64 - 1, mask.height as i64 - 1);
    let row = |y: i64| (0..=right).filter(|&x| mask.at(x, y)).count();
    let column = |x: i64| (0..=bottom).filter(|&y| mask.at(x, y)).count();
    let touching = |touches: bool, count: usize| if touches { count } else { 0 };
    [
        touching(frame.y0 == 0, row(0)),
        touching(frame.y0 + frame.height == capture.camera.height, row(bottom)),
        touching(frame.x0 == 0, column(0)),
        touching(frame.x0 + frame.width == capture.camera.width, column(right)),
    ]
}

/// `3 of 60 frames`
pub(super) fn of(frames: &[u32], all: usize) -> String {
    format!("{} of {all} frames", frames.len())
}

/// The flags that the measures raise.
pub fn clip_flags(measures: &[FrameMeasures]) -> Vec<Flag> {
    let flags = [
        few_frames(measures),
        low_resolution(measures),
        blurred_clip(measures),
        keypoints_off_mask(measures),
        few_keypoints(measures),
        cut_by_border(measures),
        mask_edge::flag(&edge_offsets(measures)),
        second_blob(measures),
        mask_flickers(measures),
        blurred(measures),
    ];
    flags.into_iter().flatten().collect()
}

fn few_frames(measures: &[FrameMeasures]) -> Option<Flag> {
    let n = measures.len();
    let flag = || Flag::of_clip(Kind::FewFrames, format!("only {n} frames were fitted"), n as f64, FEW_FRAMES as f64);
    (n < FEW_FRAMES).then(flag)
}

fn low_resolution(measures: &[FrameMeasures]) -> Option<Flag> {
    let height = median(measures.iter().map(|m| m.height_px as f64))?;
    let message = format!("the person is only {height:.0} pixels tall");
    (height < LOW_PX).then(|| Flag::of_clip(Kind::LowResolution, message, height, LOW_PX))
}

fn blurred_clip(measures: &[FrameMeasures]) -> Option<Flag> {
    let sharpness = median(measures.iter().filter_map(|m| m.sharpness))?;
    let message = "the person is blurred in most frames".to_owned();
    (sharpness < BLURRED_CLIP).then(|| Flag::of_clip(Kind::BlurredClip, message, sharpness, BLURRED_CLIP))
}

/// A flag of the frames in which `value` is beyond a limit, with the worst of them.
fn of_frames(
    measures: &[FrameMeasures],
    kind: Kind,
    what: &str,
    limit: f64,
    value: impl Fn(&FrameMeasures) -> f64,
    worse: impl Fn(f64, f64) -> bool,
) -> Option<Flag> {
    let bad: Vec<&FrameMeasures> = measures.iter().filter(|m| worse(value(m), limit)).collect();
    let worst = bad.iter().map(|m| value(m)).reduce(|a, b| if worse(b, a) { b } else { a })?;
    let frames: Vec<u32> = bad.iter().map(|m| m.frame).collect();
    let message = format!("{what} in {}", of(&frames, measures.len()));
    Some(Flag::of_frames(kind, message, frames, worst, limit))
}

fn keypoints_off_mask(measures: &[FrameMeasures]) -> Option<Flag> {
    let what = "keypoints lie away from the mask";
    of_frames(measures, Kind::KeypointsOffMask, what, 0.0, |m| m.points_off_mask as f64, |a, b| a > b)
}

fn few_keypoints(measures: &[FrameMeasures]) -> Option<Flag> {
    let (what, limit) = ("few points of the limbs were detected", LIMBS_NEEDED as f64);
    of_frames(measures, Kind::FewKeypoints, what, limit, |m| m.limbs_seen as f64, |a, b| a < b)
}

fn cut_by_border(measures: &[FrameMeasures]) -> Option<Flag> {
    let sides = ["top", "bottom", "left", "right"];
    let cut: Vec<&str> =
        (0..4).filter(|&k| measures.iter().any(|m| m.border_px[k] >= CUT_PX)).map(|k| sides[k]).collect();
    let what = format!("the person is cut off at the picture's {}", cut.join(" and "));
    let most = |m: &FrameMeasures| m.border_px.into_iter().max().unwrap_or(0) as f64;
    of_frames(measures, Kind::CutByBorder, &what, CUT_PX as f64 - 1.0, most, |a, b| a > b)
}

fn second_blob(measures: &[FrameMeasures]) -> Option<Flag> {
    let what = "the mask has a second part";
    of_frames(measures, Kind::SecondBlob, what, BLOB, |m| m.second_blob, |a, b| a > b)
}

fn mask_flickers(measures: &[FrameMeasures]) -> Option<Flag> {
    if measures.len() < FRAMES_FOR_JUMPS {
        return None;
    }
    let jumps = jumps(&measures.iter().map(|m| (f64::from(m.frame), m.mask_area_px as f64)).collect::<Vec<_>>());
    let jump = |m: &FrameMeasures| measures.iter().position(|n| n.frame == m.frame).map_or(0.0, |t| jumps[t]);
    of_frames(measures, Kind::MaskFlickers, "the mask's area jumps", JUMP, jump, |a, b| a > b)
}

/// How far each value `(frame, value)` lies from what the two on either side let expect (a cubic), as a part of it; 0 for the
/// two at each end, and where a neighbour is further off: a value that jumps makes its neighbours look odd too.
fn jumps(values: &[(f64, f64)]) -> Vec<f64> {
    let mut off = vec![0.0; values.len()];
    for (t, window) in values.windows(5).enumerate() {
        let (at, value) = window[2];
        let around = [window[0], window[1], window[3], window[4]];
        let weight = |x: f64| {
            let others = around.iter().filter(|other| other.0 != x);
            others.map(|other| (at - other.0) / (x - other.0)).product::<f64>()
        };
        let expected: f64 = around.iter().map(|&(x, y)| weight(x) * y).sum();
        off[t + 2] = (value - expected).abs() / value.max(1.0);
    }
    let is_peak = |t: usize| off[t.saturating_sub(1)..(t + 2).min(off.len())].iter().all(|&near| near <= off[t]);
    (0..off.len()).map(|t| if is_peak(t) { off[t] } else { 0.0 }).collect()
}

/// A direction is compared with itself: stripes that are hardly seen in one frame are no blur, and what a motion along the stripes of
/// a cloth leaves of its weaker direction is too little to be told without the other frames.
fn blurred(measures: &[FrameMeasures]) -> Option<Flag> {
    let usual = [0, 1].map(|k| median(measures.iter().filter_map(|m| m.sharpness_along[k])));
    let relative = |m: &FrameMeasures| {
        let both = m.sharpness_along.iter().zip(usual).filter_map(|(along, usual)| Some((*along)? / usual?));
        both.fold(1.0, f64::min)
    };
    of_frames(measures, Kind::Blurred, "the person is blurred", BLURRED, relative, |a, b| a < b)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Camera;

    const SIDE: u32 = 240;

    /// A clip of a checked box with sharp edges, with twelve points of limbs on it.
    fn capture(n: usize) -> Capture {
        let (x0, y0, width, height) = (60, 30, 120, 200);
        let inside = |x: usize, y: usize| (20..100).contains(&x) && (10..190).contains(&y);
        let pixels = || (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let check = |x: usize, y: usize| if (x / 20 + y / 20).is_multiple_of(2) { 40 } else { 200 };
        let frame = |index: usize| Frame {
            index: 2 * index as u32,
            x0,
            y0,
            width: width as u32,
            height: height as u32,
            rgb: pixels().flat_map(|(x, y)| [check(x, y); 3]).collect(),
            mask: pixels().map(|(x, y)| if inside(x, y) { 255 } else { 0 }).collect(),
            keypoints: (0..17).map(|k| [120.0, 60.0 + 9.0 * k as f32, 0.9]).collect(),
        };
        Capture {
            camera: Camera::pinhole(SIDE, SIDE, [300.0, 300.0, 120.0, 120.0]),
            uploaded_side_px: 0,
            camera_estimated: false,
            fps: 30.0,
            frames: (0..n).map(frame).collect(),
            keypoint_format: "coco17".to_owned(),
            given_keypoint_format: "coco17".to_owned(),
            poses: None,
            warnings: Vec::new(),
        }
    }

    fn flags(capture: &Capture) -> Vec<Flag> {
        clip_flags(&measure(capture))
    }

    /// The single flag of a clip of 30 frames that `spoil` has had.
    fn flag_of(spoil: impl Fn(&mut Capture)) -> Flag {
        let mut capture = capture(30);
        spoil(&mut capture);
        let mut flags = flags(&capture);
        assert_eq!(flags.len(), 1, "{flags:#?}");
        flags.remove(0)
    }

    #[test]
    fn a_good_clip_has_no_flags() {
        assert_eq!(flags(&capture(30)), []);
    }

    #[test]
    fn points_off_the_mask_are_counted_where_they_are_sure() {
        let flag = flag_of(|c| {
            c.frames[4].keypoints[9] = [10.0, 40.0, 0.9];
            c.frames[7].keypoints[9] = [10.0, 40.0, 0.9];
            c.frames[7].keypoints[10] = [10.0, 50.0, 0.9];
            c.frames[9].keypoints[10] = [10.0, 50.0, 0.3];
            // Six pixels of 180 are within what detectors miss by.
            c.frames[12].keypoints[8] = [74.0, 100.0, 0.9];
        });
        assert_eq!((flag.code, flag.frames, flag.value), ("keypoints_off_mask", vec![8, 14], 2.0));
    }

    #[test]
    fn missing_limbs_are_counted_without_the_face() {
        let flag = flag_of(|c| {
            c.frames[0].keypoints[..5].iter_mut().for_each(|p| *p = [0.0; 3]);
            c.frames[3].keypoints[8..14].iter_mut().for_each(|p| *p = [0.0; 3]);
        });
        assert_eq!((flag.code, flag.frames, flag.value), ("few_keypoints", vec![6], 6.0));
    }

    #[test]
    fn a_person_at_the_border_is_cut_there() {
        let flag = flag_of(|c| {
            c.camera.height = 230;
            let mask = &mut c.frames[5].mask;
            mask[199 * 120 + 40..199 * 120 + 60].fill(255);
            mask[190 * 120 + 40..199 * 120 + 40].fill(0);
            for y in 190..199 {
                mask[y * 120 + 40..y * 120 + 60].fill(255);
            }
        });
        assert_eq!((flag.code, flag.frames, flag.value), ("cut_by_border", vec![10], 20.0));
        assert!(flag.message.contains("bottom") && !flag.message.contains("top"), "{}", flag.message);
    }

    #[test]
    fn a_second_part_and_a_jump_of_the_area_are_seen() {
        let blob = |c: &mut Capture, frame: usize| {
            for y in 60..120 {
                c.frames[frame].mask[y * 120 + 104..y * 120 + 118].fill(255);
            }
        };
        let mut spoiled = capture(30);
        (0..30).for_each(|frame| blob(&mut spoiled, frame));
        let found = flags(&spoiled);
        assert_eq!(found.iter().map(|f| f.code).collect::<Vec<_>>(), ["second_blob"]);
        assert_eq!(found[0].frames.len(), 30);
        let mut spoiled = capture(60);
        blob(&mut spoiled, 11);
        let found = flags(&spoiled);
        assert_eq!(found.iter().map(|f| f.code).collect::<Vec<_>>(), ["second_blob", "mask_flickers"]);
        assert_eq!(found[1].frames, [22]);
        // One that comes and goes all the time is no less of a jump.
        let mut spoiled = capture(60);
        (1..60).step_by(5).for_each(|frame| blob(&mut spoiled, frame));
        let found = flags(&spoiled);
        assert_eq!((found[1].code, found[1].frames.len()), ("mask_flickers", 12));
    }

    #[test]
    fn a_cubic_is_no_jump_however_its_frames_lie() {
        let cubic = |x: f64| 9000.0 + 40.0 * x - 3.0 * x * x + 0.05 * x * x * x;
        let mut values: Vec<(f64, f64)> =
            (0..40).map(|i| f64::from(i * 3 / 2)).map(|frame| (frame, cubic(frame))).collect();
        assert!(jumps(&values).iter().all(|&jump| jump < 1e-9));
        values[20].1 *= 1.1;
        let found = jumps(&values);
        assert!((found[20] - 0.1 / 1.1).abs() < 1e-6 && found[19] == 0.0 && found[21] == 0.0, "{found:?}");
    }

    #[test]
    fn blur_is_seen_in_a_frame_and_in_a_clip() {
        // The mean over five pixels along rows, then along columns, twice.
        let smear = |frame: &mut Frame| {
            let row = 3 * frame.width as usize;
            for step in [3, row, 3, row] {
                let sharp = frame.rgb.clone();
                for i in 2 * step..sharp.len() - 2 * step {
                    let window = (0..5).map(|k| u32::from(sharp[i + k * step - 2 * step]));
                    frame.rgb[i] = (window.sum::<u32>() / 5) as u8;
                }
            }
        };
        let flag = flag_of(|c| smear(&mut c.frames[6]));
        assert_eq!((flag.code, flag.frames), ("blurred", vec![12]));
        let flag = flag_of(|c| c.frames.iter_mut().for_each(smear));
        assert_eq!((flag.code, flag.frames), ("blurred_clip", vec![]));
    }

    #[test]
    fn blur_along_the_stripes_of_a_cloth_is_seen() {
        // Upright stripes with a weak pattern along them.
        let striped = |frame: &mut Frame, smeared: bool| {
            let (width, height) = (frame.width as usize, frame.height as usize);
            let pattern = |x: usize, y: usize| {
                let stripe = if (x / 8).is_multiple_of(2) { 60 } else { 180 };
                stripe + if (y / 7).is_multiple_of(2) { 0 } else { 36 }
            };
            let rows = |y: usize| if smeared { y.saturating_sub(4)..(y + 5).min(height) } else { y..y + 1 };
            let mean = |x: usize, y: usize| rows(y).map(|y| pattern(x, y)).sum::<usize>() / rows(y).len();
            frame.rgb = (0..width * height).flat_map(|i| [mean(i % width, i / width) as u8; 3]).collect();
        };
        // Its edges, which go on beyond the mask, are no part of this.
        let blurred = |smeared: Option<usize>| {
            let mut capture = capture(24);
            capture.frames.iter_mut().enumerate().for_each(|(i, frame)| striped(frame, smeared == Some(i)));
            flags(&capture).into_iter().find(|flag| flag.code == "blurred").map(|flag| flag.frames)
        };
        assert_eq!(blurred(None), None);
        assert_eq!(blurred(Some(6)), Some(vec![12]));
    }

    #[test]
    fn short_and_small_clips_say_so() {
        let mut small = capture(8);
        for frame in &mut small.frames {
            frame.mask[150 * 120..].fill(0);
        }
        let found = flags(&small);
        let codes: Vec<&str> = found.iter().map(|f| f.code).collect();
        assert_eq!(codes, ["few_frames", "low_resolution", "keypoints_off_mask"]);
        assert_eq!((found[0].value, found[1].value), (8.0, 140.0));
    }
}
