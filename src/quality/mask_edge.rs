//! Whether the masks end where the person does: segmentations are often a few pixels too tight or too wide all round, and
//! nothing in the masks tells. The pictures do: across the person's edge colours change more than anywhere near it.

use super::flag::{Flag, Kind};
use crate::capture::{Capture, Frame};
use crate::distance::signed_distance;
use crate::mask::is_foreground;
use crate::math::median;

/// Pixels to either side of the mask's edge that are looked at.
const REACH: usize = 8;
/// The change at the person's edge over the mean of what lies on either side: with less it cannot be told.
const CLEAR: f64 = 1.6;
/// Persons less tall have limbs as thin as the reach.
const LEAST_HEIGHT_PX: usize = 100;
/// Pixels by which masks may miss.
const EDGE_OFF_PX: f64 = 1.5;

/// How far the person's edge lies outside of the mask's, pixels of the capture; negative where it lies inside. `None` where
/// the picture does not show it.
pub fn edge_offset(frame: &Frame, height_px: usize) -> Option<f64> {
    if height_px < LEAST_HEIGHT_PX {
        return None;
    }
    let changes = changes_by_distance(frame)?;
    let edge = (0..changes.len()).max_by(|&a, &b| changes[a].total_cmp(&changes[b]))?;
    let near = edge.saturating_sub(1)..=(edge + 1).min(changes.len() - 1);
    let far: Vec<f64> = (0..changes.len()).filter(|k| k.abs_diff(edge) > 2).map(|k| changes[k]).collect();
    let usual = far.iter().sum::<f64>() / far.len() as f64;
    if changes[edge] <= CLEAR * usual {
        return None;
    }
    let (mut sum, mut weights) = (0.0, 0.0);
    for k in near {
        let weight = (changes[k] - usual).max(0.0);
        sum += weight * (k as f64 + 0.5 - REACH as f64);
        weights += weight;
    }
    Some(sum / weights)
}

/// `[2 · REACH]`: mean change of the colours across the mask's edge, a pixel, by the distance from it in whole pixels; the
/// first ones are inside. `None` without an edge, or where a distance is not in the picture.
fn changes_by_distance(frame: &Frame) -> Option<Vec<f64>> {
    let (width, height) = (frame.width as usize, frame.height as usize);
    let inside: Vec<bool> = frame.mask.iter().map(|&v| is_foreground(v)).collect();
    let distance = signed_distance(&inside, width, height)?;
    let colours = frame.rgb.as_chunks::<3>().0;
    let (mut sums, mut counts) = ([0.0; 2 * REACH], [0u32; 2 * REACH]);
    for y in 1..height.saturating_sub(1) {
        for x in 1..width.saturating_sub(1) {
            let at = y * width + x;
            let bin = distance[at].floor() + REACH as f32;
            if !(0.0..2.0 * REACH as f32).contains(&bin) {
                continue;
            }
            let across = [distance[at + 1] - distance[at - 1], distance[at + width] - distance[at - width]];
            let length = across[0].hypot(across[1]);
            if length < 1.0 {
                // The middle of something thin: both its edges are as near.
                continue;
            }
            let change = |c: usize| {
                let along = |step: usize| f32::from(colours[at + step][c]) - f32::from(colours[at - step][c]);
                (along(1) * across[0] + along(width) * across[1]) / (2.0 * length)
            };
            sums[bin as usize] += f64::from((0..3).map(|c| change(c).powi(2)).sum::<f32>().sqrt());
            counts[bin as usize] += 1;
        }
    }
    let means = sums.iter().zip(counts).map(|(sum, n)| (n > 0).then(|| sum / f64::from(n)));
    means.collect()
}

/// What the frames agree on, where most of them tell and the masks miss by more than they may.
fn clip_offset(offsets: &[Option<f64>]) -> Option<f64> {
    let known: Vec<f64> = offsets.iter().flatten().copied().collect();
    let offset = if 2 * known.len() > offsets.len() { median(known)? } else { return None };
    (offset.abs() >= EDGE_OFF_PX).then_some(offset)
}

/// Grows or shrinks all masks to the person's edge where they miss it all round; says by how much.
pub fn settle_masks(capture: &mut Capture, offsets: &[Option<f64>]) -> Option<f64> {
    let offset = clip_offset(offsets)?;
    for frame in &mut capture.frames {
        let inside: Vec<bool> = frame.mask.iter().map(|&v| is_foreground(v)).collect();
        let Some(distance) = signed_distance(&inside, frame.width as usize, frame.height as usize) else { continue };
        let moved: Vec<u8> = distance.iter().map(|&d| if f64::from(d) < offset { 255 } else { 0 }).collect();
        // Nothing may be left of a small one.
        if moved.contains(&255) {
            frame.mask = moved;
        }
    }
    Some(offset)
}

pub(super) fn flag(offsets: &[Option<f64>]) -> Option<Flag> {
    let offset = clip_offset(offsets)?;
    let (side, moved) = if offset > 0.0 { ("inside", "grown") } else { ("outside", "shrunk") };
    let px = offset.abs();
    let message = format!("the masks end {px:.1} px {side} the person's edge; they were {moved} by as much");
    Some(Flag::of_clip(Kind::MaskEdgeOff, message, offset, EDGE_OFF_PX.copysign(offset)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Camera;

    const WIDTH: usize = 120;
    const HEIGHT: usize = 220;

    /// A person of an ellipse and two legs, on a background of stripes, whose mask is `by` pixels too wide.
    fn frame(by: f32) -> Frame {
        let at = |i: usize| ((i % WIDTH) as f32 + 0.5 - 60.0, (i / WIDTH) as f32 + 0.5 - 80.0);
        let body = |x: f32, y: f32| {
            (x / 30.0).hypot(y / 60.0) < 1.0 || ((8.0..22.0).contains(&x.abs()) && (0.0..120.0).contains(&y))
        };
        let inside: Vec<bool> = (0..WIDTH * HEIGHT).map(|i| body(at(i).0, at(i).1)).collect();
        let colour = |i: usize| match inside[i] {
            true => {
                if at(i).1 < 0.0 {
                    [180, 60, 60]
                } else {
                    [50, 60, 120]
                }
            }
            false => {
                if (i / 10).is_multiple_of(2) {
                    [110, 130, 110]
                } else {
                    [140, 130, 120]
                }
            }
        };
        let distance = signed_distance(&inside, WIDTH, HEIGHT).unwrap();
        Frame {
            index: 0,
            x0: 0,
            y0: 0,
            width: WIDTH as u32,
            height: HEIGHT as u32,
            rgb: (0..WIDTH * HEIGHT).flat_map(colour).collect(),
            mask: distance.iter().map(|&d| if d < by { 255 } else { 0 }).collect(),
            keypoints: Vec::new(),
        }
    }

    fn capture(frames: Vec<Frame>) -> Capture {
        Capture {
            camera: Camera::pinhole(WIDTH as u32, HEIGHT as u32, [300.0, 300.0, 60.0, 110.0]),
            uploaded_side_px: 0,
            camera_estimated: false,
            fps: 30.0,
            frames,
            keypoint_format: "coco17".to_owned(),
            given_keypoint_format: "coco17".to_owned(),
            poses: None,
            warnings: Vec::new(),
        }
    }

    #[test]
    fn the_offset_is_found_to_half_a_pixel() {
        for by in [-4.0, -2.0, 0.0, 1.0, 3.0, 5.0] {
            let found = edge_offset(&frame(by), 180).unwrap();
            assert!((found + f64::from(by)).abs() < 0.6, "{by}: {found}");
        }
    }

    #[test]
    fn what_the_picture_does_not_show_is_not_told() {
        let mut even = frame(0.0);
        even.rgb.fill(90);
        assert_eq!(edge_offset(&even, 180), None);
        assert_eq!(edge_offset(&frame(3.0), 80), None, "too small");
        let mut empty = frame(0.0);
        empty.mask.fill(0);
        assert_eq!(edge_offset(&empty, 180), None);
    }

    #[test]
    fn masks_that_miss_are_moved_to_the_edge_and_flagged() {
        let truth = frame(0.0).mask;
        for by in [-3.0, 3.0] {
            let mut spoiled = capture(vec![frame(by), frame(by), frame(by)]);
            let offsets: Vec<Option<f64>> = spoiled.frames.iter().map(|f| edge_offset(f, 180)).collect();
            let moved = settle_masks(&mut spoiled, &offsets).unwrap();
            assert!((moved + f64::from(by)).abs() < 0.6, "{by}: {moved}");
            let wrong = spoiled.frames[1].mask.iter().zip(&truth).filter(|(a, b)| a != b).count();
            let before = frame(by).mask.iter().zip(&truth).filter(|(a, b)| a != b).count();
            assert!(wrong * 4 < before, "{wrong} pixels of {before}");
            let flag = flag(&offsets).unwrap();
            assert_eq!((flag.code, flag.value), ("mask_edge_off", moved));
            assert!(flag.message.contains(if by < 0.0 { "grown by" } else { "shrunk by" }), "{}", flag.message);
        }
    }

    #[test]
    fn masks_that_fit_or_that_few_frames_blame_stay() {
        let mut good = capture(vec![frame(0.0), frame(1.0)]);
        let before: Vec<Vec<u8>> = good.frames.iter().map(|f| f.mask.clone()).collect();
        for offsets in [vec![Some(0.1), Some(-1.2)], vec![Some(4.0), None], vec![None, None], vec![]] {
            assert_eq!(settle_masks(&mut good, &offsets), None, "{offsets:?}");
            assert!(flag(&offsets).is_none());
        }
        assert_eq!(good.frames.iter().map(|f| f.mask.clone()).collect::<Vec<_>>(), before);
    }
}
