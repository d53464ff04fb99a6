use serde_json::{Value, json};

use super::body::RenderBody;
use crate::camera::Camera;
use crate::http::error::ApiError;
use crate::jobs::render::{ImageRequest, Place, PoseSource};
use crate::jobs::{Avatar, Clip, Timestamp};
use crate::picture::{Background, Light};

fn avatar() -> Avatar {
    let camera = json!({ "width": 64, "height": 48, "fx": 60.0, "fy": 60.0, "cx": 32.0, "cy": 24.0 });
    Avatar {
        id: uuid::Uuid::nil(),
        epoch: 1,
        clip: Clip { frames: 5, width: 64, height: 48, fps: 30.0, warnings: Vec::new() },
        body: "test".into(),
        frames: 2,
        camera: serde_json::from_value::<Camera>(camera).unwrap(),
        metrics: Value::Null,
        created_at: Timestamp(0),
        expires_at: None,
        files: Vec::new(),
    }
}

fn check(body: Value) -> Result<ImageRequest, ApiError> {
    serde_json::from_value::<RenderBody>(body).expect("the body has the form").check(&avatar())
}

#[test]
fn a_frame_alone_is_enough() {
    let image = check(json!({ "frame": 4 })).unwrap();
    assert_eq!(image.pose, PoseSource::Frame(4));
    assert_eq!((image.camera.width, image.light, image.background), (64, Light::Captured, Background::Transparent));
}

#[test]
fn a_pelvis_wins_over_a_translation() {
    let body = json!({ "pose": vec![0.1; 72], "translation": [1, 2, 3], "pelvis": [0, 0, 3], "background": "#ff8000" });
    let image = check(body).unwrap();
    let PoseSource::Given { pose, place } = image.pose else { panic!() };
    assert_eq!((pose.len(), place), (72, Some(Place::Pelvis([0.0, 0.0, 3.0]))));
    assert_eq!(image.background, Background::Colour([255, 128, 0]));
}

#[test]
fn a_rotation_may_be_rows_or_flat() {
    let camera = json!({ "width": 10, "height": 20, "fx": 9, "fy": 9, "cx": 5, "cy": 10, "model": "pinhole" });
    for rotation in [json!([[0, -1, 0], [1, 0, 0], [0, 0, 1]]), json!([0, -1, 0, 1, 0, 0, 0, 0, 1])] {
        let mut camera = camera.clone();
        camera["rotation"] = rotation;
        let image = check(json!({ "frame": 0, "camera": camera })).unwrap();
        assert_eq!(image.camera.rotation, [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
    }
}

#[test]
fn a_lens_may_be_a_list_or_named() {
    for lens in [
        json!({ "distortion": [0.1, 0, 0, 0.02] }),
        // As OpenCV's arrays are, and sizes that came by a division.
        json!({ "distortion": [[0.1, 0, 0, 0.02, 0]], "translation": [[0], [0], [0]], "width": 10.0 }),
        json!({ "distortion": { "k1": 0.1, "p2": 0.02 } }),
        json!({ "k1": 0.1, "p2": 0.02 }),
    ] {
        let mut camera = json!({ "width": 10, "height": 20, "fx": 9, "fy": 9, "cx": 5, "cy": 10 });
        camera.as_object_mut().unwrap().extend(lens.as_object().unwrap().clone());
        let image = check(json!({ "frame": 0, "camera": camera })).unwrap();
        assert_eq!(image.camera.distortion, [0.1, 0.0, 0.0, 0.02, 0.0], "{lens}");
    }
}

#[test]
fn each_wrong_value_is_named() {
    let camera = |change: Value| {
        let mut camera = json!({ "width": 10, "height": 20, "fx": 9, "fy": 9, "cx": 5, "cy": 10 });
        camera.as_object_mut().unwrap().extend(change.as_object().unwrap().clone());
        json!({ "frame": 0, "camera": camera })
    };
    let flip = json!([1, 0, 0, 0, 1, 0, 0, 0, -1]);
    for (body, wrong) in [
        (json!({}), "pose"),
        (json!({ "pose": vec![0; 72], "frame": 1 }), "pose"),
        (json!({ "pose": vec![0; 71] }), "pose"),
        (json!({ "pose": vec![1e9; 72] }), "pose"),
        (json!({ "frame": 5 }), "frame"),
        (json!({ "frame": 1, "pelvis": [0, 0, 0] }), "frame"),
        (json!({ "pose": vec![0; 72], "translation": [0, 0, 1e30] }), "translation"),
        (json!({ "frame": 0, "betas": vec![0; 1000] }), "betas"),
        (json!({ "frame": 0, "background": "white" }), "background"),
        (json!({ "frame": 0, "background": "#ff00f" }), "background"),
        (camera(json!({ "width": 0 })), "camera.width"),
        (camera(json!({ "height": 100_000 })), "camera.height"),
        (camera(json!({ "fx": 0 })), "camera.fx"),
        (camera(json!({ "fy": -3 })), "camera.fy"),
        (camera(json!({ "cx": 1e300 })), "camera.cx"),
        (camera(json!({ "rotation": vec![0; 9] })), "camera.rotation"),
        (camera(json!({ "rotation": flip })), "camera.rotation"),
        (camera(json!({ "k1": 1e9 })), "camera.distortion"),
    ] {
        match check(body.clone()) {
            Err(ApiError::Input { part, .. }) => assert_eq!(part, wrong, "{body}"),
            other => panic!("{body}: {:?}", other.map(|_| "accepted")),
        }
    }
}
