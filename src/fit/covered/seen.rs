//! The colours of face, toes and ears in a clip.

use glam::Vec3;

use super::{FEET, Head, OF_TOES};
use crate::body::Body;
use crate::body::joints::{NECK, PELVIS};
use crate::capture::{Capture, Frame};
use crate::fit::stage0::Stage0Result;
use crate::mask::is_foreground;
use crate::ops::project::cpu::forward as project;
use crate::ops::skinning::cpu::forward;

/// Frames that tell enough.
const FRAMES: usize = 40;
/// Cosine between where a part looks and the camera from which on it is seen.
const FACING: f32 = 0.6;
/// How far round the nose a face reaches, and round its landmark an ear, of the distance between the ears.
const FACE_REACH: f32 = 0.2;
const EAR_REACH: f32 = 0.17;
/// A colour is no skin where its luma is less than this part of the face's or more than its inverse, or where the shares of red,
/// green and blue differ by this much.
const DARKER: f32 = 0.6;
const OTHER_HUE: f32 = 0.06;

/// Medians, sRGB in 0..1, of what faces the camera; `None` of what never does.
#[derive(Clone, Copy, Debug)]
pub(super) struct Colours {
    pub(super) face: Option<[f32; 3]>,
    pub(super) toes: Option<[f32; 3]>,
    pub(super) ears: Option<[f32; 3]>,
}

pub(super) fn colours(body: &Body, capture: &Capture, start: &Stage0Result, head: &Head) -> Colours {
    let shaped: Vec<Vec3> = body.shaped_vertices(&start.betas).into_iter().map(Vec3::from).collect();
    let near = |place: Vec3, reach: f32| -> Vec<usize> {
        (0..shaped.len()).filter(|&v| shaped[v].distance(place) < reach * head.width()).collect()
    };
    let face = near(head.nose, FACE_REACH);
    let ears = head.ears.map(|ear| near(ear, EAR_REACH));
    let toes = FEET.map(|[_, foot]| -> Vec<usize> {
        (0..shaped.len()).filter(|&v| body.weight_of(v, |j| j as usize == foot) > OF_TOES).collect()
    });
    let (all, kept) = (capture.frames.len(), capture.frames.len().min(FRAMES));
    let mut samples: [Vec<[u8; 3]>; 3] = Default::default();
    for i in (0..kept).map(|k| k * all / kept) {
        let frame = &capture.frames[i];
        let posed = forward(body, &start.betas, None, &start.poses[i], start.transl[i]);
        let (view, screen) = project(&start.camera, &posed.vertices);
        let joints = project(&start.camera, &posed.joints).0;
        let place = |v: usize| Vec3::from(view[v]);
        let mut look = |part: usize, vertices: &[usize], at: Vec3, to: Vec3| {
            if faces_camera(at, to) {
                samples[part].extend(vertices.iter().filter_map(|&v| colour(frame, screen[v])));
            }
        };
        let [left, right] = head.ear_vertices.map(place);
        let nose = face.iter().map(|&v| place(v)).sum::<Vec3>() / face.len().max(1) as f32;
        look(0, &face, nose, nose - left.midpoint(right));
        // A camera that stands near looks down on the feet: by their heading they look at it all the same.
        let up = (Vec3::from(joints[NECK]) - Vec3::from(joints[PELVIS])).normalize_or_zero();
        for (toes, feet) in toes.iter().zip(FEET) {
            let [ankle, foot] = feet.map(|joint| Vec3::from(joints[joint]).reject_from_normalized(up));
            look(1, toes, foot, foot - ankle);
        }
        look(2, &ears[0], left, left - right);
        look(2, &ears[1], right, right - left);
    }
    let [face, toes, ears] = samples.map(median);
    Colours { face, toes, ears }
}

/// Whether a part's colour is another one than the face's in any light that falls on both.
pub(super) fn is_other_than_skin(part: [f32; 3], face: [f32; 3]) -> bool {
    let luma = |[r, g, b]: [f32; 3]| (0.3 * r + 0.59 * g + 0.11 * b).max(1e-3);
    let share = |c: [f32; 3]| Vec3::from(c) / c.iter().sum::<f32>().max(1e-3);
    let brightness = luma(part) / luma(face);
    !(DARKER..1.0 / DARKER).contains(&brightness) || share(part).distance(share(face)) > OTHER_HUE
}

/// Of each channel, within [0, 1]; of an even number the lower of the two in the middle.
fn median(mut samples: Vec<[u8; 3]>) -> Option<[f32; 3]> {
    let middle = samples.len().checked_sub(1)? / 2;
    Some(std::array::from_fn(|channel| {
        samples.sort_unstable_by_key(|colour| colour[channel]);
        f32::from(samples[middle][channel]) / 255.0
    }))
}

/// Whether what lies at a place in view space and looks in a direction looks at the camera.
fn faces_camera(at: Vec3, to: Vec3) -> bool {
    (-at).normalize_or_zero().dot(to.normalize_or_zero()) > FACING
}

/// The pixel at a place of the whole image, if it is the person's.
fn colour(frame: &Frame, [x, y]: [f32; 2]) -> Option<[u8; 3]> {
    let (x, y) = (x.floor() - frame.x0 as f32, y.floor() - frame.y0 as f32);
    let within = (0.0..frame.width as f32).contains(&x) && (0.0..frame.height as f32).contains(&y);
    let pixel = within.then(|| y as usize * frame.width as usize + x as usize)?;
    let colour = frame.rgb.get(3 * pixel..)?.first_chunk::<3>()?;
    is_foreground(*frame.mask.get(pixel)?).then_some(*colour)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shoes_and_hair_are_told_from_skin_in_shade() {
        let skin = [0.80, 0.62, 0.53];
        for bare in [skin, skin.map(|c| 0.7 * c), skin.map(|c| 1.2 * c), [0.82, 0.60, 0.55]] {
            assert!(!is_other_than_skin(bare, skin), "{bare:?}");
        }
        for cover in [[0.1, 0.1, 0.1], [0.35, 0.25, 0.18], [0.95, 0.95, 0.95], [0.5, 0.5, 0.8], [0.3, 0.3, 0.32]] {
            assert!(is_other_than_skin(cover, skin), "{cover:?}");
        }
    }

    #[test]
    fn the_median_is_of_each_channel_and_none_of_nothing() {
        assert_eq!(median(vec![[0, 255, 51], [255, 0, 51], [51, 51, 51]]), Some([0.2, 0.2, 0.2]));
        assert_eq!(median(Vec::new()), None);
    }
}
