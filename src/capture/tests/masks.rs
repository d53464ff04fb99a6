//! Masks in the forms that people's tools write, and by themselves.

use super::*;

#[test]
fn masks_as_a_video_and_as_cut_outs() {
    let clip = Clip::new();
    clip.masks(&encode((0..COUNT).map(mask), "gray", &["-c:v", "ffv1", "-f", "matroska"]));
    assert_is_the_clip(&clip.load().unwrap(), 12);
    let cut_out = |i| -> Vec<u8> { rgb(i).chunks(3).zip(mask(i)).flat_map(|(c, a)| [c[0], c[1], c[2], a]).collect() };
    let cut_out = |i| png(&cut_out(i), WIDTH, HEIGHT, image::ExtendedColorType::Rgba8);
    clip.masks(&zip((0..COUNT).map(|i| (format!("{i:04}.png"), cut_out(i)))));
    assert_is_the_clip(&clip.load().unwrap(), 12);
}

#[test]
fn masks_as_the_transparency_of_a_video() {
    let encoders = Command::new("ffmpeg").args(["-v", "error", "-encoders"]).output().unwrap().stdout;
    let encoders = String::from_utf8(encoders).unwrap();
    // The person dark, the rest light and transparent: the wrong way round without the transparency.
    let cut_out = |i| -> Vec<u8> {
        let pixels = mask(i).into_iter();
        pixels.flat_map(|a| if a == 0 { [230, 230, 230, 0] } else { [20, 20, 20, 255] }).collect()
    };
    let opaque = |i| -> Vec<u8> { mask(i).into_iter().flat_map(|v| [v, v, v, 255]).collect() };
    #[rustfmt::skip]
    let cases: [&[&str]; 4] = [
        &["-c:v", "ffv1", "-pix_fmt", "yuva420p", "-f", "matroska"],
        &["-c:v", "qtrle", "-pix_fmt", "argb", "-f", "mov"],
        &["-c:v", "prores_ks", "-profile:v", "4444", "-pix_fmt", "yuva444p10le", "-f", "mov"],
        &["-c:v", "libvpx-vp9", "-lossless", "1", "-pix_fmt", "yuva420p", "-f", "webm"],
    ];
    for arguments in cases {
        if !encoders.contains(arguments[1]) {
            eprintln!("{}: ignored, this FFmpeg cannot write it", arguments[1]);
            continue;
        }
        for pictures in [&cut_out as &dyn Fn(usize) -> Vec<u8>, &opaque] {
            let clip = Clip::new();
            clip.masks(&encode((0..COUNT).map(pictures), "rgba", arguments));
            eprintln!("{}", arguments[1]);
            assert_is_the_clip(&clip.load().unwrap(), 12);
        }
    }
}

#[test]
fn alpha_that_a_codec_has_blurred_is_opaque() {
    let nearly =
        |i| -> Vec<u8> { mask(i).into_iter().enumerate().flat_map(|(k, v)| [v, v, v, 255 - (k % 3) as u8]).collect() };
    let clip = Clip::new();
    clip.masks(&encode((0..COUNT).map(nearly), "rgba", &["-c:v", "qtrle", "-pix_fmt", "argb", "-f", "mov"]));
    assert_is_the_clip(&clip.load().unwrap(), 12);
}

#[test]
fn masks_by_themselves_are_read_as_a_clips_are() {
    let mut clip = Clip::new();
    let cut_out = |i| -> Vec<u8> { mask(i).into_iter().flat_map(|a| [255 - a / 2, 255, 255, a]).collect() };
    let png = |i| png(&cut_out(i), WIDTH, HEIGHT, image::ExtendedColorType::Rgba8);
    let junk = ("__MACOSX/._0.png".to_owned(), b"x".to_vec());
    clip.masks(&zip((0..COUNT).map(|i| (format!("{i}.png"), png(i))).chain([junk])));
    let found = masks(&clip.inputs.masks, None, &[10, 2, 40, 2]).unwrap();
    let found: Vec<_> = found.into_iter().map(|mask| mask.map(|mask| mask.into_raw())).collect();
    assert_eq!(found, [Some(mask(10)), Some(mask(2)), None, Some(mask(2))]);

    // Without the lens's distortion, as a fit sees them.
    let camera = serde_json::json!({"width": WIDTH, "height": HEIGHT, "fx": 90.0, "fy": 90.0, "cx": 32.0, "cy": 48.0,
        "distortion": [0.3]});
    clip.inputs.camera = clip.add("camera", camera.to_string());
    let straight = masks(&clip.inputs.masks, clip.inputs.camera.as_deref(), &[4]).unwrap()[0].clone().unwrap();
    assert_ne!(straight.as_raw(), &mask(4));
    let capture = clip.load().unwrap();
    let frame = &capture.frames[4];
    let crop = image::imageops::crop_imm(&straight, frame.x0, frame.y0, frame.width, frame.height).to_image();
    assert_eq!(crop.as_raw(), &frame.mask);

    clip.masks(b"no masks");
    assert!(masks(&clip.inputs.masks, None, &[0]).is_err());
}

#[test]
fn masks_that_are_maps_of_labels() {
    let clip = Clip::new();
    let told = |warnings: &[String]| warnings.iter().filter(|w| w.contains("maps of labels")).count();
    // Numbers of parts; the first frame shows nobody.
    let part = |i: usize, k: usize| if i == 0 { 0 } else { 1 + (k / 640) as u8 % 5 };
    let numbers =
        |i| -> Vec<u8> { mask(i).into_iter().enumerate().map(|(k, v)| if v > 0 { part(i, k) } else { 0 }).collect() };
    let number = |i| png(&numbers(i), WIDTH, HEIGHT, image::ExtendedColorType::L8);
    clip.masks(&zip((0..COUNT).map(|i| (format!("{i}.png"), number(i)))));
    let capture = clip.load().unwrap();
    assert_eq!(told(&capture.warnings), 1, "{:?}", capture.warnings);
    let found = masks(&clip.inputs.masks, None, &[0, 2]).unwrap();
    let found: Vec<_> = found.into_iter().map(|mask| mask.unwrap().into_raw()).collect();
    assert_eq!(found, [vec![0; (WIDTH * HEIGHT) as usize], mask(2)]);
    // Their colours.
    let colours =
        |i| -> Vec<u8> { numbers(i).into_iter().flat_map(|n| [50 * n, 0, if n == 0 { 0 } else { 250 }]).collect() };
    let colour = |i| png(&colours(i + 1), WIDTH, HEIGHT, image::ExtendedColorType::Rgb8);
    clip.masks(&zip((0..COUNT).map(|i| (format!("{i}.png"), colour(i)))));
    let found = masks(&clip.inputs.masks, None, &[2]).unwrap();
    assert_eq!(found[0].as_ref().unwrap().as_raw(), &mask(3));
}
