//! Pictures and clips for tests.

use crate::camera::Camera;
use crate::capture::{Capture, Frame};

pub fn picture(index: u32, [x0, y0, width, height]: [u32; 4]) -> Frame {
    let n = (width * height) as usize;
    let rgb = (0..n).flat_map(|i| [i as u8, index as u8, 7]).collect();
    Frame { index, x0, y0, width, height, rgb, mask: vec![255; n], keypoints: Vec::new() }
}

pub fn capture(n: u32, side: u32, uploaded_side_px: u32, person: u32) -> Capture {
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
