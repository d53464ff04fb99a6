//! The fuzzer's way into the parsers of a clip's parts ([`crate::fuzz_entries`]).

use std::io::Write;
use std::path::Path;
use std::time::{Duration, Instant};

use super::images::ImageStream;
use super::source::Pixels;
use super::{Part, calibration};

/// Parts are read from files.
fn in_a_file(bytes: &[u8], parse: impl FnOnce(&Path)) {
    let mut file = tempfile::NamedTempFile::new().expect("a temporary file");
    file.write_all(bytes).expect("a temporary file");
    parse(file.path());
}

/// Keypoints: JSON, or a zip of OpenPose's.
pub fn keypoints(bytes: &[u8]) {
    in_a_file(bytes, |path| {
        let Ok(read) = super::keypoints::read(path) else { return };
        for person in read.frames.iter().flatten() {
            assert_eq!(person.len(), read.format.points);
            assert!(person.iter().all(|point| (0.0..=1.0).contains(&point[2])), "confidences");
        }
    });
}

/// A camera: JSON.
pub fn camera(bytes: &[u8]) {
    in_a_file(bytes, |path| {
        let Ok(camera) = calibration::read(path) else { return };
        let numbers = [camera.fx, camera.fy, camera.cx, camera.cy];
        let numbers = numbers.iter().chain(&camera.distortion).chain(&camera.rotation).chain(&camera.translation);
        assert!(numbers.into_iter().all(|x| x.is_finite()) && camera.fx > 0.0 && camera.fy > 0.0);
    });
}

/// Known poses: an npz.
pub fn poses(bytes: &[u8]) {
    in_a_file(bytes, |path| {
        let Ok((known, _)) = super::poses::read(path) else { return };
        assert_eq!(known.poses.len(), known.trans.len());
        assert!(known.poses.iter().all(|pose| pose.len() == 72 && pose.iter().all(|x| x.is_finite())));
    });
}

/// Masks: a zip of images, each decoded.
pub fn masks(bytes: &[u8]) {
    in_a_file(bytes, |path| {
        let deadline = Instant::now() + Duration::from_secs(20);
        let Ok(mut images) = ImageStream::open(Part::Masks, path, Pixels::Mask, deadline) else { return };
        while let Ok(Some(picture)) = images.next(true) {
            assert_eq!(picture.data.len(), picture.width as usize * picture.height as usize);
        }
    });
}
