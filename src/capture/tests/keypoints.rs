//! Keypoints as detectors write them.

use super::*;

#[test]
fn keypoints_of_frames_that_are_left_out_smooth_the_others() {
    let clip = Clip::new();
    clip.video(&encode((0..30).map(|_| rgb(0)), "rgb24", &MP4));
    clip.masks(&zip((0..30).map(|i| (format!("masks/{i}.png"), mask_png(0)))));
    // As good as at random.
    let noise = |i: usize| 1.5 * ((i * i) as f64).sin();
    let detected = |i: usize| points(0).into_iter().map(move |[x, y, c]| [x + noise(i), y, c]).collect();
    clip.keypoints(keypoint_json(&(0..30).map(detected).collect::<Vec<_>>()));
    let errors = |max_frames| {
        let capture =
            Capture::load(&clip.inputs, &CaptureOptions { max_frames, max_side_px: 96 }, &mut |_| true).unwrap();
        capture.frames.iter().map(|f| f64::from(f.keypoints[5][0]) - points(0)[5][0]).collect::<Vec<f64>>()
    };
    let squares = |errors: &[f64]| errors.iter().map(|e| e * e).sum::<f64>();
    let raw = errors(30);
    assert!((0..30).all(|i| (raw[i] - noise(i)).abs() < 1e-4), "{raw:?}");
    let (smoothed, thinned) = (errors(10), raw.iter().step_by(3).copied().collect::<Vec<_>>());
    assert_eq!(smoothed.len(), thinned.len());
    assert!(squares(&smoothed) < 0.5 * squares(&thinned), "{smoothed:?} of {thinned:?}");
}

#[test]
fn openpose_files_of_several_people() {
    let clip = Clip::new();
    let numbers = |i: usize, dx: f64| -> Vec<f64> {
        (0..25).flat_map(|k| points(i)[k % 17]).enumerate().map(|(n, v)| if n % 3 == 0 { v + dx } else { v }).collect()
    };
    let person = |i, dx| serde_json::json!({"person_id": [-1], "pose_keypoints_2d": numbers(i, dx)});
    let file = |i: usize| match i {
        0 => serde_json::json!({"version": 1.3, "people": []}),
        // The bystander comes first.
        _ => serde_json::json!({"version": 1.3, "people": [person(i, 28.0), person(i, 0.0)]}),
    };
    clip.keypoints(zip((0..COUNT).map(|i| (format!("clip_{i:012}_keypoints.json"), file(i).to_string().into()))));
    let capture = clip.load().unwrap();
    assert_eq!(capture.keypoint_format, "body25");
    assert_eq!(capture.frames[0].keypoints, vec![[0.0; 3]; 25]);
    assert_eq!(capture.frames[5].keypoints[2][0], points(5)[2][0] as f32);
    assert_eq!(capture.warnings, ["keypoints: nobody is seen in 1 frames, the first of them 0"]);

    // Our own JSON, compressed.
    let document = keypoint_json(&(0..COUNT).map(points).collect::<Vec<_>>());
    clip.keypoints(zip([("./keypoints.json".to_owned(), document.into_bytes())]));
    assert_is_the_clip(&clip.load().unwrap(), 12);

    clip.keypoints(zip((0..COUNT - 1).map(|i| (format!("{i}.json"), file(i).to_string().into()))));
    let error = clip.error();
    assert_eq!(error.message, "there are 11 frames of keypoints, the video has 12");
    assert_eq!(
        error.expected,
        "12, one for each frame of the video; `[]`, or a file without people, for one in which nobody was found"
    );
    let with_a_gap = (0..COUNT).filter(|&i| i != 4);
    clip.keypoints(zip(with_a_gap.map(|i| (format!("clip_{i:012}_keypoints.json"), file(i).to_string().into()))));
    let message = "there are 11 frames of keypoints, the video has 12; the names of the zip's files leave out 4";
    assert_eq!(clip.error().message, message);
    let named = (0..COUNT).map(|i| match i {
        3 => ("3_camera.json".to_owned(), br#"{"fx": 1}"#.to_vec()),
        _ => (format!("{i}.json"), file(i).to_string().into_bytes()),
    });
    clip.keypoints(zip(named));
    assert!(clip.error().message.starts_with("`3_camera.json`: the JSON cannot be used: missing field `people`"));
}

#[test]
fn keypoints_of_pictures_of_another_size_are_brought_to_the_videos() {
    let clip = Clip::new();
    let file = |i: usize, scale: f64, canvas: [f64; 2]| {
        let numbers: Vec<f64> = points(i).into_iter().flat_map(|[x, y, c]| [x * scale, y * scale, c]).collect();
        let people = serde_json::json!([{ "pose_keypoints_2d": numbers }]);
        serde_json::json!({ "people": people, "canvas_width": canvas[0], "canvas_height": canvas[1] })
            .to_string()
            .into_bytes()
    };
    let whole = |scale: f64, canvas: [f64; 2]| zip((0..COUNT).map(|i| (format!("{i}.json"), file(i, scale, canvas))));
    clip.keypoints(whole(2.0, [128.0, 192.0]));
    let capture = clip.load().unwrap();
    assert_eq!(capture.frames[5].keypoints[2], points(5)[2].map(|v| v as f32));
    assert_eq!(capture.warnings, ["keypoints: they are of 128×192 pictures and were brought to 64×96"]);
    clip.keypoints(whole(1.0, [64.0, 96.0]));
    assert!(clip.load().unwrap().warnings.is_empty());
    clip.keypoints(whole(1.0, [96.0, 64.0]));
    assert_eq!(clip.error().message, "they are of 96×64 pictures");
}

#[test]
fn text_as_tools_on_windows_write_it_is_read() {
    let mut clip = Clip::new();
    let text = keypoint_json(&(0..COUNT).map(points).collect::<Vec<_>>());
    clip.keypoints([b"\xef\xbb\xbf", text.as_bytes()].concat());
    let camera = "\u{feff}{\"width\": 64, \"height\": 96, \"fx\": 80, \"fy\": 80, \"cx\": 32, \"cy\": 48}";
    clip.inputs.camera = clip.add("camera", camera);
    assert_is_the_clip(&clip.load().unwrap(), 12);
    clip.keypoints([b"\xff\xfe".to_vec(), text.encode_utf16().flat_map(u16::to_le_bytes).collect()].concat());
    assert_eq!((clip.error().part, clip.error().message.as_str()), (Part::Keypoints, "the text is UTF-16"));
    clip.inputs.camera = clip.add("camera", camera.encode_utf16().flat_map(u16::to_le_bytes).collect::<Vec<u8>>());
    assert_eq!((clip.error().part, clip.error().message.as_str()), (Part::Camera, "the text is UTF-16"));
}
