//! Clips that must be refused, each with the part, the frame and the words of its refusal.

use super::*;

#[track_caller]
fn assert_error(clip: &Clip, part: Part, frame: Option<u32>, message: &str) {
    let error = clip.error();
    assert_eq!((error.part, error.frame), (part, frame), "{error}");
    assert!(error.message.starts_with(message), "{error}");
    let text = error.to_string();
    assert!(!text.contains("/tmp") && !text.contains("0x"), "{text}");
}

#[test]
fn a_video_that_is_no_video() {
    let clip = Clip::new();
    for bytes in [&b""[..], b"hello, this is text", &[0; 5000]] {
        clip.video(bytes);
        assert_error(&clip, Part::Video, None, "this is no readable video");
    }
    clip.video(b"PK\x03\x04 and then nonsense");
    assert_error(&clip, Part::Video, None, "the zip cannot be read");
}

#[test]
fn files_that_name_other_files_are_not_followed() {
    let clip = Clip::new();
    let other = clip.add("other.mp4", video(&MP4)).unwrap();
    let other = other.display();
    for text in [
        format!("#EXTM3U\n#EXT-X-TARGETDURATION:10\n#EXTINF:1,\nfile://{other}\n#EXT-X-ENDLIST\n"),
        format!("ffconcat version 1.0\nfile '{other}'\n"),
        format!(r#"<svg xmlns="http://www.w3.org/2000/svg"><image href="file://{other}"/></svg>"#),
    ] {
        clip.video(text.as_bytes());
        assert_error(&clip, Part::Video, None, "this is no readable video");
    }
}

#[test]
fn sound_alone() {
    let clip = Clip::new();
    let sound = ["-f", "lavfi", "-i", "sine=duration=0.2", "-map", "1:a", "-c:a", "aac", "-f", "mp4"];
    clip.video(&video(&sound));
    assert_error(&clip, Part::Video, None, "the file holds no video stream");
}

#[test]
fn a_truncated_file() {
    let clip = Clip::new();
    let whole = video(&MP4);
    clip.video(&whole[..whole.len() / 2]);
    assert_error(&clip, Part::Video, None, "this is no readable video: moov atom not found");
    let early_index = video(&[&MP4[..], &["-movflags", "faststart"]].concat());
    clip.video(&early_index[..early_index.len() * 2 / 3]);
    let error = clip.error();
    assert!(error.message.starts_with("the file is damaged or cut off: "), "{error}");
    assert!(error.message.contains(" of 12 frames could be read"), "{error}");
    // Other containers do not tell how many frames they should have.
    let stream = video(&MKV);
    clip.video(&stream[..stream.len() * 2 / 3]);
    assert_error(&clip, Part::Video, None, "the file is damaged");
}

#[test]
fn more_frames_or_pixels_than_are_allowed() {
    let clip = Clip::new();
    let made = |source: &str| {
        video(&[&["-f", "lavfi", "-i", source, "-map", "1:v"], &["-c:v", "mjpeg", "-f", "mov"][..]].concat())
    };
    clip.video(&made("color=size=16x16:rate=25:duration=160"));
    assert_error(&clip, Part::Video, None, "there are more than 3600 frames");
    clip.video(&made("color=size=8192x4096:rate=25:duration=0.04"));
    assert_error(&clip, Part::Video, None, "the images are 8192×4096");
}

#[test]
fn a_picture_that_was_written_half_is_found_before_the_job_is_taken() {
    let clip = Clip::new();
    let mut last = rgb_png(COUNT - 1);
    last.truncate(last.len() - 40);
    clip.video(
        &zip((0..COUNT).map(|i| (format!("{i:02}.png"), if i + 1 < COUNT { rgb_png(i) } else { last.clone() }))),
    );
    assert_error(&clip, Part::Video, Some(COUNT as u32 - 1), "`11.png` cannot be read");
}

#[test]
fn no_frames_at_all() {
    let clip = Clip::new();
    clip.video(&encode(std::iter::empty(), "rgb24", &MKV));
    assert_eq!(clip.error().part, Part::Video);
}

#[test]
fn masks_of_another_count_or_size() {
    let clip = Clip::new();
    clip.masks(&mask_zip(COUNT - 2));
    assert_error(&clip, Part::Masks, None, "there are 10 frames of masks, the video has 12");
    clip.masks(&mask_zip(COUNT + 1));
    assert_error(&clip, Part::Masks, None, "there are 13 frames of masks, the video has 12");
    let half = |i: usize| -> Vec<u8> { mask(i)[..(WIDTH * HEIGHT / 2) as usize].to_vec() };
    let half = |i| png(&half(i), WIDTH, HEIGHT / 2, image::ExtendedColorType::L8);
    clip.masks(&zip((0..COUNT).map(|i| (format!("{i}.png"), if i == 7 { half(i) } else { mask_png(i) }))));
    assert_error(&clip, Part::Masks, Some(7), "the mask is 64×48");
}

#[test]
fn empty_masks() {
    let clip = Clip::new();
    let black = png(&vec![0; (WIDTH * HEIGHT) as usize], WIDTH, HEIGHT, image::ExtendedColorType::L8);
    let files = |empty: fn(usize) -> bool| {
        zip((0..COUNT).map(|i| (format!("{i}.png"), if empty(i) { black.clone() } else { mask_png(i) })))
    };
    clip.masks(&files(|_| true));
    assert_error(&clip, Part::Masks, None, "all 12 masks are empty; their brightest pixel is 0");
    clip.masks(&files(|i| i >= 4));
    assert_error(&clip, Part::Masks, Some(4), "the mask is empty, 0 pixels are foreground; 8 of 12 masks are");
    // Whoever walks in is not there yet.
    clip.masks(&files(|i| i < 3));
    let error = Capture::load_frames(&clip.inputs, &[1], 96, &mut |_| true).unwrap_err();
    assert_eq!(error.bad_input().unwrap().message, "of the 1 frames that are kept, each has an empty mask");
    let speck = mask_of(|x, y| (21..23).contains(&x) && (31..33).contains(&y));
    clip.masks(&zip((0..COUNT).map(|i| (format!("{i}.png"), speck.clone()))));
    clip.keypoints(keypoint_json(&vec![vec![[22.0, 32.0, 0.9]; 17]; COUNT]));
    let error =
        Capture::load(&clip.inputs, &CaptureOptions { max_frames: 4, max_side_px: 16 }, &mut |_| true).unwrap_err();
    let bad = error.bad_input().unwrap();
    assert_eq!((bad.frame, bad.message.as_str()), (Some(0), "nothing of the mask is left at 11×16 pixels"));
    clip.keypoints(keypoint_json(&(0..COUNT).map(points).collect::<Vec<_>>()));
    // Of a video, what is nearly black may as well be what compression has left.
    clip.masks(&encode(
        (0..COUNT).map(|i| mask(i).into_iter().map(|v| v.min(1)).collect()),
        "gray",
        &["-c:v", "ffv1", "-f", "matroska"],
    ));
    assert_error(&clip, Part::Masks, None, "all 12 masks are empty; their brightest pixel is 1");
}

#[test]
fn keypoints_with_wrong_counts_strings_or_nan() {
    let clip = Clip::new();
    let good: Vec<_> = (0..COUNT).map(points).collect();
    clip.keypoints(keypoint_json(&good[1..]));
    assert_error(&clip, Part::Keypoints, None, "there are 11 frames of keypoints, the video has 12");
    let mut short = good.clone();
    short[3].pop();
    clip.keypoints(keypoint_json(&short));
    assert_error(&clip, Part::Keypoints, Some(3), "there are 16 points");
    let text = keypoint_json(&good);
    for odd in ["NaN", "\"30\"", "null"] {
        // The x of every point of frame 6, and of no other frame.
        clip.keypoints(text.replace("[30.0,", &format!("[{odd},")));
        assert_error(&clip, Part::Keypoints, Some(6), "point 0 cannot be used");
    }
}

#[test]
fn keypoints_of_something_else() {
    let clip = Clip::new();
    let moved = |f: fn([f64; 3]) -> [f64; 3]| {
        keypoint_json(&(0..COUNT).map(|i| points(i).into_iter().map(f).collect()).collect::<Vec<_>>())
    };
    clip.keypoints(moved(|[x, y, c]| [x / 64.0, y / 96.0, c]));
    assert_error(&clip, Part::Keypoints, None, "no coordinate is above ");
    clip.keypoints(moved(|[x, y, c]| [x * 20.0, y * 20.0, c]));
    assert_error(&clip, Part::Keypoints, None, "204 of 204 points lie far outside the images");
    clip.keypoints(moved(|[_, y, c]| [2.0, y, c]));
    assert_error(&clip, Part::Keypoints, None, "204 of 204 points lie off the masks");
    clip.keypoints(moved(|[x, y, _]| [x, y, (x - 31.0) / 64.0]));
    let error = clip.error();
    assert!(error.message.contains("confidences are below 0") && error.expected.contains("not its `z`"), "{error}");
    clip.keypoints(moved(|[x, y, _]| [x, y, 0.0]));
    assert_error(&clip, Part::Keypoints, None, "no point of any frame has a confidence above 0");
}

#[test]
fn zips_that_climb_or_explode() {
    let clip = Clip::new();
    clip.masks(&zip([("../0.png".to_owned(), mask_png(0))]));
    assert_error(&clip, Part::Masks, None, "the zip has an entry named `../0.png`");
    clip.masks(&zip([("0.png".to_owned(), vec![0; 3 << 20])]));
    assert_error(&clip, Part::Masks, None, "`0.png` expands from ");
    clip.masks(&zip((0..=3600).map(|i| (format!("{i}.png"), Vec::new()))));
    assert_error(&clip, Part::Masks, None, "there are more than 3600 frames");
    clip.masks(&zip((0..=20_000).map(|i| (format!("{i}"), Vec::new()))));
    assert_error(&clip, Part::Masks, None, "the zip has too many entries");
    clip.masks(&zip([("0.png".to_owned(), b"no image".to_vec())]));
    assert_error(&clip, Part::Masks, Some(0), "`0.png` cannot be read");
}

#[test]
fn an_image_of_absurd_size_is_refused_by_its_header() {
    let clip = Clip::new();
    let mut header = b"IHDR".to_vec();
    header.extend([100_000u32, 100_000].iter().flat_map(|n| n.to_be_bytes()));
    header.extend([8, 0, 0, 0, 0]);
    let mut crc = flate2::Crc::new();
    crc.update(&header);
    let mut bytes = b"\x89PNG\r\n\x1a\n\0\0\0\r".to_vec();
    bytes.extend(&header);
    bytes.extend(crc.sum().to_be_bytes());
    bytes.extend(b"\0\0\0\0IDAT\x35\xaf\x06\x1e");
    clip.masks(&zip([("0.png".to_owned(), bytes)]));
    assert_error(&clip, Part::Masks, Some(0), "the images are 100000×100000");
}

#[test]
fn cameras_and_poses_of_another_clip() {
    let mut clip = Clip::new();
    clip.inputs.camera = clip.add("camera", r#"{"width": 64, "height": 96, "fx": 0, "fy": 0, "cx": 32, "cy": 48}"#);
    assert_error(&clip, Part::Camera, None, "the focal length `fx` is 0");
    let double = r#"{"width": 128, "height": 192, "fx": 160, "fy": 160, "cx": 64, "cy": 96}"#;
    clip.inputs.camera = clip.add("camera", double);
    assert_error(&clip, Part::Camera, None, "the camera is of 128×192 images; divide");
    let folding = r#"{"width": 64, "height": 96, "fx": 80, "fy": 80, "cx": 32, "cy": 48, "k1": -5}"#;
    clip.inputs.camera = clip.add("camera", folding);
    assert_error(&clip, Part::Camera, None, "the distortion folds the image over");
    clip.inputs.camera = None;
    let mut npz = NpzWriter::new(Cursor::new(Vec::new()));
    npz.add("poses", &[5, 72], &[0.0f32; 360]).unwrap();
    npz.add("trans", &[5, 3], &[0.0f32; 15]).unwrap();
    clip.inputs.poses = clip.add("poses", npz.finish().unwrap().into_inner());
    assert_error(&clip, Part::Poses, None, "there are 5 frames of poses, the video has 12");
    let of = |root: [f32; 3], trans: [f32; 3]| {
        let mut pose = [0.0; 72];
        pose[..3].copy_from_slice(&root);
        let mut npz = NpzWriter::new(Cursor::new(Vec::new()));
        npz.add("poses", &[COUNT, 72], &[pose; COUNT].concat()).unwrap();
        npz.add("trans", &[COUNT, 3], &[trans; COUNT].concat()).unwrap();
        npz.finish().unwrap().into_inner()
    };
    for (root, trans, message) in [
        ([180.0, 0.0, 0.0], [0.0, 0.0, 3.0], "`poses` holds 180"),
        ([3.1, 0.0, 0.0], [0.0, 0.0, 300.0], "`trans` holds 300"),
    ] {
        clip.inputs.poses = clip.add("poses", of(root, trans));
        assert_error(&clip, Part::Poses, Some(0), message);
    }
    clip.inputs.poses = clip.add("poses", "no archive");
    assert_error(&clip, Part::Poses, None, "not an npz archive");
}

#[test]
fn a_missing_file_is_our_fault() {
    let clip = Clip::new();
    std::fs::remove_file(&clip.inputs.video).unwrap();
    assert!(inspect(&clip.inputs).unwrap_err().bad_input().is_none());
}
