use glam::DVec2;

use super::flow::{LEVELS, follow, texture};
use super::picture::Picture;
use super::search;
use crate::body::Body;
use crate::capture::Frame;
use crate::fit::stage0::synthetic::{Difficulty, Errors, clip, errors};
use crate::fit::stage0::{Stage0Options, Stage0Result, solve};

/// 80 × 60 pixels of `grey` about a moved origin, the mask without its last ten columns.
fn frame(x0: u32, grey: impl Fn(DVec2) -> f64) -> Frame {
    let (width, height) = (80, 60);
    let at = |i: u32| DVec2::new(f64::from(i % width) + 0.5 + f64::from(x0), f64::from(i / width) + 0.5);
    Frame {
        index: 0,
        x0,
        y0: 0,
        width,
        height,
        rgb: (0..width * height).flat_map(|i| [grey(at(i)).round() as u8; 3]).collect(),
        mask: (0..width * height).map(|i| if i % width < width - 10 { 255 } else { 0 }).collect(),
        keypoints: Vec::new(),
    }
}

fn blobs(at: DVec2) -> f64 {
    110.0 + 50.0 * (at.x * 0.45).sin() * (at.y * 0.38 + 1.0).cos() + 20.0 * (0.2 * at.x - 0.31 * at.y).sin()
}

#[test]
fn a_patch_is_found_to_a_fraction_of_a_pixel_in_other_light_and_another_crop() {
    let moved = DVec2::new(3.4, -2.3);
    let here = Picture::new(&frame(0, blobs), LEVELS);
    let there = Picture::new(&frame(6, |at| blobs(at - moved) + 25.0), LEVELS);
    for at in [DVec2::new(30.0, 30.0), DVec2::new(41.5, 22.0), DVec2::new(50.2, 37.7)] {
        let found = follow(&here, &there, at, 6).unwrap();
        assert!(found.distance(at + moved) < 0.1, "{at} went to {found}");
    }
}

#[test]
fn what_looks_the_same_along_a_line_is_not_followed() {
    let place = DVec2::new(35.0, 30.0);
    let flat = frame(0, |_| 90.0);
    let stripes = frame(0, |at| 110.0 + 60.0 * (0.5 * at.x).sin());
    let known = frame(0, blobs);
    let texture_of = |frame: &Frame| texture(&Picture::new(frame, LEVELS).levels[0], place, 6);
    assert_eq!((texture_of(&flat), texture_of(&stripes)), (0.0, 0.0));
    assert!(texture_of(&known) > 3.0);
    // Beyond the mask's edge.
    assert_eq!(texture(&Picture::new(&known, LEVELS).levels[0], DVec2::new(76.0, 30.0), 6), 0.0);
    let (before, after) = (Picture::new(&stripes, LEVELS), Picture::new(&stripes, LEVELS));
    assert!(follow(&before, &after, place, 6).is_none());
}

fn painted(frames: usize) -> Difficulty {
    Difficulty { frames, noise_px: 5.0, masks: true, painted: true, seed: 21, ..Difficulty::default() }
}

#[test]
fn points_are_followed_over_many_frames_of_a_turn() {
    let body = Body::test_body();
    let mut clip = clip(&body, &painted(24));
    let tracks = search::find(&clip.capture, 450.0, || true).unwrap();
    assert!(tracks.len() > 40, "{} points", tracks.len());
    assert!(tracks.windows(2).all(|pair| pair[0].places.len() >= pair[1].places.len()), "the longest first");
    assert!(tracks.iter().all(|track| track.first + track.places.len() <= 24));
    let mut frames = 0;
    let stops = || {
        frames += 1;
        frames < 5
    };
    assert!(search::find(&clip.capture, 450.0, stops).is_none() && frames == 5, "stops before the fifth frame");
    clip.capture.frames.iter_mut().for_each(|frame| frame.rgb.clear());
    assert!(
        search::find(&clip.capture, 450.0, || true).unwrap().is_empty(),
        "without colours there is nothing to follow"
    );
}

#[test]
fn what_is_followed_tells_poses_that_a_noisy_detector_does_not() {
    let body = Body::test_body();
    let mut clip = clip(&body, &painted(30));
    let solved = |clip: &crate::fit::stage0::synthetic::Clip| -> (Stage0Result, Errors) {
        let result = solve(&body, &clip.capture, &Stage0Options::default(), &mut |_| true).unwrap();
        let errors = errors(&body, clip, &result);
        (result, errors)
    };
    let (result, with) = solved(&clip);
    assert!(result.report.tracked_points > 30, "{}", result.report.tracked_points);
    clip.capture.frames.iter_mut().for_each(|frame| frame.rgb.clear());
    let (result, without) = solved(&clip);
    assert_eq!(result.report.tracked_points, 0);
    assert!(with.scaled < 0.85 * without.scaled, "{with:?} and without {without:?}");
    assert!(with.facing_degrees < without.facing_degrees, "{with:?} and without {without:?}");
}
