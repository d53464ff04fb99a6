//! What the fit tells about the clip.

use super::clip::of;
use super::flag::{Flag, Kind};
use crate::camera::Camera;
use crate::math::median;

/// A turn that leaves a gap shows in the avatar.
const FULL_TURN_DEGREES: f64 = 330.0;
/// A frame's IoU that is low by itself, or low beside the clip's median.
const LOW_IOU: f64 = 0.85;
const BELOW_MEDIAN: f64 = 0.04;
/// Field of view along the longer side: from a phone's tele lens to its widest one.
const VIEWS_DEGREES: [f64; 2] = [15.0, 110.0];

/// A height is guessed between what proportions tell and what people usually have, so a guess that lies this far from the
/// usual means a person much farther from it, metres.
const HEIGHT_OFF_M: f64 = 0.06;

/// So far from the fitted joints, over the person's height, keypoints cost new poses decibels (docs/robustness.md).
const NOISY: f64 = 0.008;

/// So near, in parts of the person's height, perspective makes pictures of other poses worse (docs/filming.md).
const NEAR: f64 = 1.0;

/// A focal length that came with a clip and is not the one that the clip tells.
#[derive(Clone, Copy, Debug)]
pub struct ContradictedFocal {
    pub given_px: f64,
    /// What the clip tells, over the given one, and how far from 1 it may lie, as a factor above it
    pub ratio: f64,
    pub limit: f64,
}

/// Poses that came with a clip and are not those that its keypoints show.
#[derive(Clone, Copy, Debug)]
pub struct ContradictedPoses {
    /// By how much their joints are off in a frame, 1σ, and how much is not worse than what is found without poses, degrees.
    pub off_degrees: f64,
    pub limit_degrees: f64,
    /// Poses of the fit's own took their place.
    pub replaced: bool,
}

/// What is known at the end of a fit.
#[derive(Clone, Debug)]
pub struct FitFindings<'a> {
    /// `[N]` of the video
    pub frames: &'a [u32],
    /// `[N]` of the avatar's mask with the clip's
    pub iou: &'a [f64],
    /// `[N, 72]`: joint 0 is the root's axis-angle, world space
    pub poses: &'a [[f32; 72]],
    /// Frames of the video whose sides were exchanged
    pub swapped: &'a [u32],
    pub camera: &'a Camera,
    pub camera_estimated: bool,
    /// `[N]` from the camera to the pelvis, in heights of the undressed body: what one camera can tell of distance
    pub distances: &'a [f64],
    pub contradicted_focal: Option<ContradictedFocal>,
    pub contradicted_poses: Option<ContradictedPoses>,
    /// Of the frames with keypoints: root mean square from them to the joints that stage 0 finds, over the person's height
    pub keypoint_residuals: &'a [f64],
    /// The undressed body's height where it was guessed, and what it is expected to be, metres
    pub guessed_height_m: Option<f64>,
    pub usual_height_m: f64,
    /// The brightest frame's exposure over the darkest one's, in the channel in which they differ most, where the camera has changed it
    pub exposure_spread: Option<f64>,
    /// Where cloth ends that hangs from leg to leg, from hip (0) to ankle (1)
    pub hem: Option<f64>,
}

/// The flags that a fit raises.
pub fn fit_flags(found: &FitFindings<'_>) -> Vec<Flag> {
    let flags = [
        no_full_turn(found),
        near_camera(found),
        focal_estimated(found),
        focal_suspicious(found),
        focal_contradicted(found),
        poses_contradicted(found),
        height_unusual(found),
        exposure_changes(found),
        keypoints_noisy(found),
        sides_swapped(found),
        fit_misses(found),
        cloth_between_legs(found),
    ];
    flags.into_iter().flatten().collect()
}

/// Facings this far apart say nothing of what lies between them.
const WIDEST_USUAL_GAP_DEGREES: f64 = 45.0;

/// Degrees of the circle that the person's facings, as the camera sees them, cover: 360 without the largest gap between
/// neighbouring facings, as far as it is larger than the usual one.
pub fn turn_coverage_degrees(poses: &[[f32; 72]], camera: &Camera) -> f64 {
    // The world's axes may lie in any way, the camera stands upright.
    let [xx, xy, xz, _, _, _, zx, zy, zz] = camera.rotation.map(|x| x as f32);
    let facing = |pose: &[f32; 72]| {
        let root = glam::Quat::from_scaled_axis(glam::Vec3::new(pose[0], pose[1], pose[2]));
        let ahead = root * glam::Vec3::Z;
        let ahead = glam::Vec2::new(glam::Vec3::new(xx, xy, xz).dot(ahead), glam::Vec3::new(zx, zy, zz).dot(ahead));
        f64::from(ahead.x.atan2(ahead.y)).to_degrees().rem_euclid(360.0)
    };
    let mut facings: Vec<f64> = poses.iter().map(facing).collect();
    facings.sort_by(f64::total_cmp);
    let Some((&first, &last)) = facings.first().zip(facings.last()) else { return 0.0 };
    let mut gaps: Vec<f64> = facings.windows(2).map(|pair| pair[1] - pair[0]).collect();
    gaps.push(first + 360.0 - last);
    let largest = gaps.iter().copied().fold(0.0, f64::max);
    // Facings are samples of a turn: between two of them lies what either nearly shows.
    let usual = (360.0 / facings.len() as f64).min(WIDEST_USUAL_GAP_DEGREES);
    (360.0 - (largest - usual).max(0.0)).clamp(0.0, 360.0)
}

fn no_full_turn(found: &FitFindings<'_>) -> Option<Flag> {
    let covered = turn_coverage_degrees(found.poses, found.camera);
    let message = format!("the person turned through {covered:.0} of 360 degrees");
    (covered < FULL_TURN_DEGREES).then(|| Flag::of_clip(Kind::NoFullTurn, message, covered, FULL_TURN_DEGREES))
}

fn near_camera(found: &FitFindings<'_>) -> Option<Flag> {
    let distance = median(found.distances.iter().copied())?;
    let message = format!("the camera was {distance:.1} times the person's height away");
    (distance < NEAR).then(|| Flag::of_clip(Kind::NearCamera, message, distance, NEAR))
}

/// The camera's longer side and its focal length along it, pixels.
fn long_side(camera: &Camera) -> (u32, f64) {
    if camera.width >= camera.height { (camera.width, camera.fx) } else { (camera.height, camera.fy) }
}

fn focal_suspicious(found: &FitFindings<'_>) -> Option<Flag> {
    let (side, focal) = long_side(found.camera);
    let view = 2.0 * (0.5 * f64::from(side) / focal).atan().to_degrees();
    let [narrow, wide] = VIEWS_DEGREES;
    let message = format!("a focal length of {focal:.0} px means a view of {view:.0} degrees");
    let limit = if view < narrow { narrow } else { wide };
    (!(narrow..=wide).contains(&view)).then(|| Flag::of_clip(Kind::FocalSuspicious, message, view, limit))
}

fn focal_estimated(found: &FitFindings<'_>) -> Option<Flag> {
    let (_, focal) = long_side(found.camera);
    let message = format!("no focal length was given; {focal:.0} px were found");
    (found.camera_estimated && found.contradicted_focal.is_none())
        .then(|| Flag::of_clip(Kind::FocalEstimated, message, focal, 0.0))
}

fn focal_contradicted(found: &FitFindings<'_>) -> Option<Flag> {
    let ContradictedFocal { given_px, ratio, limit } = found.contradicted_focal?;
    let limit = if ratio < 1.0 { 1.0 / limit } else { limit };
    let told = ratio * given_px;
    let taken = match found.camera_estimated {
        true => format!("it was fitted with {:.0} px", found.camera.fx),
        false => "it was fitted with that, as `trust_camera` asks".to_owned(),
    };
    let message =
        format!("the clip looks like one of a focal length of {told:.0} px, not of the given {given_px:.0}; {taken}");
    Some(Flag::of_clip(Kind::FocalContradicted, message, ratio, limit))
}

fn poses_contradicted(found: &FitFindings<'_>) -> Option<Flag> {
    let ContradictedPoses { off_degrees, limit_degrees, replaced } = found.contradicted_poses?;
    let taken = match replaced {
        true => "poses that were found without them took their place",
        false => "none that explain the keypoints as well were found without them, so they were kept",
    };
    let message =
        format!("the given poses are {off_degrees:.1} degrees a joint off what keypoints show in a frame; {taken}");
    Some(Flag::of_clip(Kind::PosesContradicted, message, off_degrees, limit_degrees))
}

fn height_unusual(found: &FitFindings<'_>) -> Option<Flag> {
    let (guessed, usual) = (found.guessed_height_m?, found.usual_height_m);
    let (limit, size) = match guessed < usual {
        true => (usual - HEIGHT_OFF_M, "small"),
        false => (usual + HEIGHT_OFF_M, "tall"),
    };
    let message =
        format!("the proportions are those of somebody {size}; no height was given, {guessed:.2} m were guessed");
    ((guessed - usual).abs() > HEIGHT_OFF_M).then(|| Flag::of_clip(Kind::HeightUnusual, message, guessed, limit))
}

fn exposure_changes(found: &FitFindings<'_>) -> Option<Flag> {
    let spread = found.exposure_spread?;
    let message = format!(
        "the camera changed its exposure or white balance by up to {:.0} percent; the pictures were evened out",
        100.0 * (spread - 1.0)
    );
    Some(Flag::of_clip(Kind::ExposureChanges, message, spread, 1.0))
}

fn cloth_between_legs(found: &FitFindings<'_>) -> Option<Flag> {
    let hem = found.hem?;
    let message = format!("a skirt or coat hangs from leg to leg, over {:.0} percent of their length", 100.0 * hem);
    Some(Flag::of_clip(Kind::ClothBetweenLegs, message, hem, 0.0))
}

fn keypoints_noisy(found: &FitFindings<'_>) -> Option<Flag> {
    let residual = median(found.keypoint_residuals.iter().copied())?;
    let message =
        format!("keypoints lie {:.1} percent of the person's height from the fitted joints", 100.0 * residual);
    (residual > NOISY).then(|| Flag::of_clip(Kind::KeypointsNoisy, message, residual, NOISY))
}

fn sides_swapped(found: &FitFindings<'_>) -> Option<Flag> {
    let (swapped, all) = (found.swapped, found.frames.len());
    let message = format!("left and right were exchanged in {}", of(swapped, all));
    let part = swapped.len() as f64 / all.max(1) as f64;
    (!swapped.is_empty()).then(|| Flag::of_frames(Kind::SidesSwapped, message, swapped.to_vec(), part, 0.0))
}

fn fit_misses(found: &FitFindings<'_>) -> Option<Flag> {
    let limit = (median(found.iou.iter().copied())? - BELOW_MEDIAN).max(LOW_IOU);
    let low = || found.frames.iter().zip(found.iou).filter(|(_, iou)| **iou < limit);
    let frames: Vec<u32> = low().map(|(frame, _)| *frame).collect();
    let worst = low().map(|(_, iou)| *iou).reduce(f64::min)?;
    let message = format!("the fit does not fill the mask in {}", of(&frames, found.frames.len()));
    Some(Flag::of_frames(Kind::FitMisses, message, frames, worst, limit))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `n` facings over `degrees`, upside down as a camera's y axis has it.
    fn turn(n: usize, degrees: f32) -> Vec<[f32; 72]> {
        let pose = |i: usize| {
            let angle = degrees.to_radians() * i as f32 / n as f32;
            let root = glam::Quat::from_rotation_x(std::f32::consts::PI) * glam::Quat::from_rotation_y(angle);
            let mut pose = [0.0; 72];
            pose[..3].copy_from_slice(&root.to_scaled_axis().to_array());
            pose
        };
        (0..n).map(pose).collect()
    }

    #[test]
    fn coverage_is_what_the_facings_leave_no_gap_in() {
        let camera = Camera::pinhole(360, 640, [700.0, 700.0, 180.0, 320.0]);
        // z points up, and the camera looks along y.
        let z_up = Camera { rotation: [1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0], ..camera.clone() };
        let to_world = glam::Quat::from_rotation_x(-std::f32::consts::FRAC_PI_2);
        assert_eq!(turn_coverage_degrees(&[], &camera), 0.0);
        let many = [(60, 360.0, 360.0), (60, 270.0, 271.5), (8, 360.0, 360.0), (60, 540.0, 360.0)];
        for (n, degrees, want) in many.into_iter().chain([(1, 360.0, 45.0), (2, 360.0, 225.0)]) {
            let poses = turn(n, degrees);
            let turned = |pose: &[f32; 72]| {
                let root = glam::Quat::from_scaled_axis(glam::Vec3::new(pose[0], pose[1], pose[2]));
                let mut pose = *pose;
                pose[..3].copy_from_slice(&(to_world * root).to_scaled_axis().to_array());
                pose
            };
            let in_world: Vec<[f32; 72]> = poses.iter().map(turned).collect();
            for covered in [turn_coverage_degrees(&poses, &camera), turn_coverage_degrees(&in_world, &z_up)] {
                assert!((covered - want).abs() < 4.0, "{n} frames over {degrees}: {covered}");
            }
        }
    }

    #[test]
    fn each_finding_has_its_flag() {
        let poses = turn(40, 200.0);
        let frames: Vec<u32> = (0..40).collect();
        let mut iou = vec![0.97; 40];
        (iou[3], iou[9]) = (0.91, 0.5);
        let camera = Camera::pinhole(360, 640, [700.0, 700.0, 180.0, 320.0]);
        let good = FitFindings {
            frames: &frames,
            iou: &[0.96; 40],
            poses: &turn(40, 360.0),
            swapped: &[],
            camera: &camera,
            camera_estimated: false,
            distances: &[1.7; 40],
            contradicted_focal: None,
            contradicted_poses: None,
            keypoint_residuals: &[0.003; 40],
            guessed_height_m: Some(1.68),
            usual_height_m: 1.65,
            exposure_spread: None,
            hem: None,
        };
        assert_eq!(fit_flags(&good), []);
        let bad = FitFindings { iou: &iou, poses: &poses, swapped: &[20, 21], camera_estimated: true, ..good.clone() };
        let flags = fit_flags(&bad);
        let codes: Vec<&str> = flags.iter().map(|f| f.code).collect();
        assert_eq!(codes, ["no_full_turn", "focal_estimated", "sides_swapped", "fit_misses"]);
        assert!((flags[0].value - 204.0).abs() < 2.0, "{}", flags[0].value);
        assert_eq!((flags[2].frames.as_slice(), flags[2].value), (&[20, 21][..], 0.05));
        assert_eq!((flags[3].frames.as_slice(), flags[3].value), (&[3, 9][..], 0.5));
        for (estimated, taken) in [(true, "fitted with 700 px"), (false, "trust_camera")] {
            let contradicted_focal = Some(ContradictedFocal { given_px: 500.0, ratio: 1.4, limit: 1.13 });
            let flags = fit_flags(&FitFindings { contradicted_focal, camera_estimated: estimated, ..good.clone() });
            assert_eq!(flags.iter().map(|f| (f.code, f.value)).collect::<Vec<_>>(), [("focal_contradicted", 1.4)]);
            let message = &flags[0].message;
            assert!(["700 px", "given 500", taken].iter().all(|part| message.contains(part)), "{message}");
        }
        for (replaced, taken) in [(true, "took their place"), (false, "kept")] {
            let contradicted_poses = Some(ContradictedPoses { off_degrees: 1.5, limit_degrees: 0.5, replaced });
            let flags = fit_flags(&FitFindings { contradicted_poses, ..good.clone() });
            assert_eq!(flags.iter().map(|f| (f.code, f.value)).collect::<Vec<_>>(), [("poses_contradicted", 1.5)]);
            assert!(flags[0].message.contains(taken), "{}", flags[0].message);
        }
        for (height, word) in [(1.57, "small"), (1.73, "tall")] {
            let flags = fit_flags(&FitFindings { guessed_height_m: Some(height), ..good.clone() });
            assert_eq!(flags.iter().map(|f| (f.code, f.value)).collect::<Vec<_>>(), [("height_unusual", height)]);
            assert!(flags[0].message.contains(word), "{}", flags[0].message);
        }
        assert_eq!(fit_flags(&FitFindings { guessed_height_m: None, ..good.clone() }), []);
        let flags = fit_flags(&FitFindings { hem: Some(0.52), ..good.clone() });
        assert_eq!(flags.iter().map(|f| (f.code, f.value)).collect::<Vec<_>>(), [("cloth_between_legs", 0.52)]);
        assert!(flags[0].message.contains("52 percent"), "{}", flags[0].message);
        let flags = fit_flags(&FitFindings { exposure_spread: Some(1.42), ..good.clone() });
        assert_eq!(flags.iter().map(|f| (f.code, f.value)).collect::<Vec<_>>(), [("exposure_changes", 1.42)]);
        assert!(flags[0].message.contains("42 percent"), "{}", flags[0].message);
        let flags = fit_flags(&FitFindings { keypoint_residuals: &[0.004, 0.011, 0.012], ..good.clone() });
        assert_eq!(flags.iter().map(|f| (f.code, f.value)).collect::<Vec<_>>(), [("keypoints_noisy", 0.011)]);
        assert!(flags[0].message.contains("1.1 percent"), "{}", flags[0].message);
        assert_eq!(fit_flags(&FitFindings { keypoint_residuals: &[], ..good.clone() }), []);
        let flags = fit_flags(&FitFindings { distances: &[1.2, 0.91, 0.8], ..good.clone() });
        assert_eq!(flags.iter().map(|f| (f.code, f.value)).collect::<Vec<_>>(), [("near_camera", 0.91)]);
        assert!(flags[0].message.contains("0.9 times"), "{}", flags[0].message);
        let odd = Camera { fy: 4000.0, ..camera.clone() };
        let flags = fit_flags(&FitFindings { camera: &odd, ..good.clone() });
        assert_eq!(flags.iter().map(|f| f.code).collect::<Vec<_>>(), ["focal_suspicious"]);
        assert!((flags[0].value - 9.1).abs() < 0.1);
        let flags = fit_flags(&FitFindings { camera: &odd, camera_estimated: true, ..good });
        assert_eq!(flags.iter().map(|f| f.code).collect::<Vec<_>>(), ["focal_estimated", "focal_suspicious"]);
    }
}
