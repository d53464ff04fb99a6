//! Whole clips, good and bad, made on the spot. They need the system's FFmpeg.

mod bad_input;
mod keypoints;
mod masks;

use std::io::{Cursor, Write};
use std::path::PathBuf;
use std::process::{Command, Stdio};

use super::*;
use crate::npz::NpzWriter;

const WIDTH: u32 = 64;
const HEIGHT: u32 = 96;
const COUNT: usize = 12;

/// A clip of a box that walks to the right and changes its colour, in a temporary folder.
struct Clip {
    folder: tempfile::TempDir,
    inputs: CaptureInputs,
}

/// The person's box in a frame: x0, y0, x1, y1.
fn person(i: usize) -> [u32; 4] {
    [14 + i as u32, 16, 34 + i as u32, 80]
}

fn is_inside(i: usize, pixel: u32) -> bool {
    let ([x0, y0, x1, y1], x, y) = (person(i), pixel % WIDTH, pixel / WIDTH);
    (x0..x1).contains(&x) && (y0..y1).contains(&y)
}

fn colour(i: usize) -> [u8; 3] {
    [200, 40 + 10 * i as u8, 60]
}

fn rgb(i: usize) -> Vec<u8> {
    (0..WIDTH * HEIGHT).flat_map(|p| if is_inside(i, p) { colour(i) } else { [90, 110, 120] }).collect()
}

fn mask(i: usize) -> Vec<u8> {
    (0..WIDTH * HEIGHT).map(|p| if is_inside(i, p) { 255 } else { 0 }).collect()
}

fn png(data: &[u8], width: u32, height: u32, colour: image::ExtendedColorType) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    image::write_buffer_with_format(&mut bytes, data, width, height, colour, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}

fn mask_png(i: usize) -> Vec<u8> {
    png(&mask(i), WIDTH, HEIGHT, image::ExtendedColorType::L8)
}

/// A mask of the pixels (x, y) that `is_foreground` names.
fn mask_of(is_foreground: impl Fn(u32, u32) -> bool) -> Vec<u8> {
    let values = (0..WIDTH * HEIGHT).map(|p| if is_foreground(p % WIDTH, p / WIDTH) { 255 } else { 0 });
    png(&values.collect::<Vec<u8>>(), WIDTH, HEIGHT, image::ExtendedColorType::L8)
}

fn rgb_png(i: usize) -> Vec<u8> {
    png(&rgb(i), WIDTH, HEIGHT, image::ExtendedColorType::Rgb8)
}

fn zip(files: impl IntoIterator<Item = (String, Vec<u8>)>) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in files {
        zip.start_file(name, zip::write::SimpleFileOptions::default()).unwrap();
        zip.write_all(&bytes).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

fn mask_zip(count: usize) -> Vec<u8> {
    zip((0..count).map(|i| (format!("masks/{i}.png"), mask_png(i))))
}

/// Video of the frames as FFmpeg writes it with these arguments.
fn encode(frames: impl Iterator<Item = Vec<u8>>, format: &str, arguments: &[&str]) -> Vec<u8> {
    let file = tempfile::NamedTempFile::new().unwrap();
    let size = format!("{WIDTH}x{HEIGHT}");
    let mut ffmpeg = Command::new("ffmpeg")
        .args(["-y", "-v", "error", "-f", "rawvideo", "-pix_fmt", format, "-s", &size, "-r", "25", "-i", "pipe:0"])
        .args(arguments)
        .arg(file.path())
        .stdin(Stdio::piped())
        .spawn()
        .expect("the tests need FFmpeg");
    let mut stdin = ffmpeg.stdin.take().unwrap();
    for frame in frames {
        match stdin.write_all(&frame) {
            // FFmpeg has all that it wants, where the arguments want other inputs.
            Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => break,
            written => written.unwrap(),
        }
    }
    drop(stdin);
    assert!(ffmpeg.wait().unwrap().success(), "{arguments:?}");
    std::fs::read(file.path()).unwrap()
}

const MP4: [&str; 6] = ["-c:v", "mpeg4", "-q:v", "2", "-f", "mp4"];
const MKV: [&str; 6] = ["-c:v", "mpeg4", "-q:v", "2", "-f", "matroska"];

fn video(arguments: &[&str]) -> Vec<u8> {
    encode((0..COUNT).map(rgb), "rgb24", arguments)
}

/// COCO-17 points of a frame: all over the person.
fn points(i: usize) -> Vec<[f64; 3]> {
    let [x0, y0, ..] = person(i).map(f64::from);
    (0..17).map(|k| [x0 + 10.0, y0 + 3.0 * f64::from(k) + 4.0, 0.9]).collect()
}

fn keypoint_json(frames: &[Vec<[f64; 3]>]) -> String {
    serde_json::json!({"format": "COCO-17", "frames": frames}).to_string()
}

impl Clip {
    fn new() -> Self {
        static VIDEO: std::sync::OnceLock<Vec<u8>> = std::sync::OnceLock::new();
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str| folder.path().join(name);
        let inputs = CaptureInputs {
            video: file("video"),
            masks: file("masks"),
            keypoints: file("keypoints"),
            camera: None,
            poses: None,
        };
        let clip = Self { folder, inputs };
        clip.video(VIDEO.get_or_init(|| video(&MP4)));
        clip.masks(&mask_zip(COUNT));
        clip.keypoints(keypoint_json(&(0..COUNT).map(points).collect::<Vec<_>>()));
        clip
    }

    fn video(&self, bytes: &[u8]) {
        std::fs::write(&self.inputs.video, bytes).unwrap();
    }

    fn masks(&self, bytes: &[u8]) {
        std::fs::write(&self.inputs.masks, bytes).unwrap();
    }

    fn keypoints(&self, bytes: impl AsRef<[u8]>) {
        std::fs::write(&self.inputs.keypoints, bytes).unwrap();
    }

    fn add(&self, name: &str, bytes: impl AsRef<[u8]>) -> Option<PathBuf> {
        let path = self.folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        Some(path)
    }

    fn load(&self) -> Result<Capture, CaptureError> {
        Capture::load(&self.inputs, &CaptureOptions { max_frames: 100, max_side_px: 1000 }, &mut |_| true)
    }

    /// The error of both ways in, which must agree.
    #[track_caller]
    fn error(&self) -> BadInput {
        let inspected = inspect(&self.inputs).expect_err("inspect took it");
        let loaded = self.load().map(|_| ()).expect_err("load took it");
        let CaptureError::Bad(loaded) = loaded else { panic!("{loaded}") };
        assert_eq!(inspected.bad_input().map(|bad| bad.part), Some(loaded.part), "{inspected} and {loaded}");
        loaded
    }
}

/// All frames in order: the box where it should be, in its colour, under its mask, with its keypoints.
#[track_caller]
fn assert_is_the_clip(capture: &Capture, tolerance: i32) {
    assert_eq!((capture.camera.width, capture.camera.height), (WIDTH, HEIGHT));
    assert_eq!(capture.frames.len(), COUNT, "{:?}", capture.warnings);
    for (i, frame) in capture.frames.iter().enumerate() {
        let [x0, y0, x1, y1] = person(i);
        assert_eq!(frame.index as usize, i);
        assert!(frame.x0 <= x0 && frame.y0 <= y0 && frame.x0 + frame.width >= x1 && frame.y0 + frame.height >= y1);
        assert_eq!(frame.rgb.len(), (frame.width * frame.height * 3) as usize);
        let at = |x: u32, y: u32| ((y - frame.y0) * frame.width + x - frame.x0) as usize;
        let middle = at((x0 + x1) / 2, (y0 + y1) / 2);
        let pixel = &frame.rgb[3 * middle..3 * middle + 3];
        let off = pixel.iter().zip(colour(i)).map(|(a, b)| (i32::from(*a) - i32::from(b)).abs()).max();
        assert!(off <= Some(tolerance), "frame {i}: {pixel:?}, not {:?}", colour(i));
        let inside = frame.mask.iter().filter(|&&v| v == 255).count();
        assert_eq!((inside, frame.mask[at(x0, y0)], frame.mask[at(x1, y1)]), (20 * 64, 255, 0), "frame {i}");
        let want = points(i)[16];
        assert_eq!(frame.keypoints[16], [want[0] as f32, want[1] as f32, 0.9]);
    }
}

#[test]
fn a_good_clip() {
    let clip = Clip::new();
    let inspection = inspect(&clip.inputs).unwrap();
    assert_eq!((inspection.frames, inspection.width, inspection.height), (12, WIDTH, HEIGHT));
    assert_eq!((inspection.fps, inspection.keypoint_format.as_str()), (25.0, "coco17"));
    assert!(inspection.warnings.is_empty(), "{:?}", inspection.warnings);
    let capture = clip.load().unwrap();
    assert_is_the_clip(&capture, 12);
    assert!(capture.camera_estimated && capture.poses.is_none() && capture.warnings.is_empty());
}

#[test]
fn every_codec_that_this_ffmpeg_writes() {
    let encoders = Command::new("ffmpeg").args(["-v", "error", "-encoders"]).output().unwrap().stdout;
    let encoders = String::from_utf8(encoders).unwrap();
    #[rustfmt::skip]
    let cases: [&[&str]; 5] = [
        &["-c:v", "libx264", "-preset", "ultrafast", "-crf", "8", "-pix_fmt", "yuv420p", "-f", "mp4"],
        &["-c:v", "libx265", "-preset", "ultrafast", "-crf", "8", "-x265-params", "log-level=none", "-f", "mp4"],
        &["-c:v", "libvpx-vp9", "-deadline", "realtime", "-cpu-used", "8", "-crf", "8", "-b:v", "0", "-f", "webm"],
        &["-c:v", "libaom-av1", "-usage", "realtime", "-cpu-used", "8", "-crf", "8", "-f", "webm"],
        &["-c:v", "ffv1", "-f", "matroska"],
    ];
    for arguments in cases {
        if !encoders.contains(arguments[1]) {
            eprintln!("{}: ignored, this FFmpeg cannot write it", arguments[1]);
            continue;
        }
        let clip = Clip::new();
        clip.video(&video(arguments));
        eprintln!("{}", arguments[1]);
        assert_is_the_clip(&clip.load().unwrap(), 16);
    }
}

#[test]
fn colours_follow_their_tags() {
    for (matrix, range) in [("bt601", "tv"), ("bt709", "tv"), ("bt709", "pc")] {
        let scale = format!("scale=out_color_matrix={matrix}:out_range={range}:flags=accurate_rnd+full_chroma_inp");
        let tag = if matrix == "bt601" { "smpte170m" } else { matrix };
        let ffv1 = ["-c:v", "ffv1", "-pix_fmt", "yuv444p", "-colorspace", tag, "-color_range", range, "-f", "matroska"];
        let clip = Clip::new();
        clip.video(&video(&[&["-vf", &scale], &ffv1[..]].concat()));
        eprintln!("{matrix} {range}");
        assert_is_the_clip(&clip.load().unwrap(), 3);
    }
}

/// HLG and PQ signals (ITU-R BT.2100) of an sRGB colour, of which white is shown with 203 cd/m² (ITU-R BT.2408).
fn hdr_signals([r, g, b]: [u8; 3]) -> [[f64; 3]; 2] {
    let light = [r, g, b].map(|c| {
        let c = f64::from(c) / 255.0;
        if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
    });
    // ITU-R BT.2087
    const WIDER: [[f64; 3]; 3] = [[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]];
    let shown = WIDER.map(|row| 203.0 * row.iter().zip(light).map(|(m, c)| m * c).sum::<f64>());
    let luminance = (0.2627 * shown[0] + 0.6780 * shown[1] + 0.0593 * shown[2]) / 1000.0;
    let hlg = shown.map(|c| {
        let scene = c / 1000.0 / luminance.powf(0.2 / 1.2);
        if scene <= 1.0 / 12.0 {
            (3.0 * scene).sqrt()
        } else {
            0.178_832_77 * (12.0 * scene - 0.284_668_92).ln() + 0.559_910_73
        }
    });
    let pq = shown.map(|c| {
        let y = (c / 10_000.0).powf(0.159_301_757_812_5);
        ((0.8359375 + 18.8515625 * y) / (1.0 + 18.6875 * y)).powf(78.84375)
    });
    [hlg, pq]
}

#[test]
fn hdr_is_brought_to_srgb() {
    let filters = Command::new("ffmpeg").args(["-v", "error", "-filters"]).output().unwrap().stdout;
    if !String::from_utf8(filters).unwrap().contains(" zscale ") {
        eprintln!("ignored, this FFmpeg has no `zscale`");
        return;
    }
    let tags = ["-color_primaries", "bt2020", "-colorspace", "bt2020nc"];
    for (kind, transfer) in ["arib-std-b67", "smpte2084"].into_iter().enumerate() {
        for tags in [&tags[..], &[]] {
            let signals = |frame: Vec<u8>| -> Vec<u8> {
                let pixels = frame.as_chunks().0.iter().flat_map(|&pixel| hdr_signals(pixel)[kind]);
                pixels.flat_map(|c| ((65535.0 * c).round() as u16).to_le_bytes()).collect()
            };
            let scale = "scale=out_color_matrix=bt2020:out_range=tv:flags=accurate_rnd+full_chroma_inp";
            #[rustfmt::skip]
            let ffv1 = ["-vf", scale, "-c:v", "ffv1", "-pix_fmt", "yuv444p10le", "-color_trc", transfer, "-f", "matroska"];
            let clip = Clip::new();
            clip.video(&encode((0..COUNT).map(|i| signals(rgb(i))), "rgb48le", &[tags, &ffv1].concat()));
            eprintln!("{transfer} {tags:?}");
            let capture = clip.load().unwrap();
            assert_is_the_clip(&capture, 6);
            assert!(capture.warnings.is_empty(), "{:?}", capture.warnings);
            // Of frames that are left out the size alone is looked at.
            let numbers: Vec<u32> = [3, 9].into_iter().chain(100..300).collect();
            let some = Capture::load_frames(&clip.inputs, &numbers, 96, &mut |_| true).unwrap();
            let pictures = |capture: &Capture| capture.frames.iter().map(|f| f.rgb.clone()).collect::<Vec<_>>();
            let all = pictures(&capture);
            assert_eq!(pictures(&some), [all[3].clone(), all[9].clone()]);
        }
    }
}

#[test]
fn zips_of_images_in_the_order_of_their_numbers() {
    let mut clip = Clip::new();
    let images = (0..COUNT).map(|i| (format!("a/frame{i}.png"), rgb_png(i)));
    let junk = ["__MACOSX/a/._frame0.png", "a/.DS_Store", "a/notes.txt"].map(|name| (name.to_owned(), b"x".to_vec()));
    clip.video(&zip(images.chain(junk)));
    let capture = clip.load().unwrap();
    assert_is_the_clip(&capture, 0);
    assert_eq!(capture.fps, 30.0);
    let warnings = inspect(&clip.inputs).unwrap().warnings;
    assert_eq!(warnings[0], "video: 1 files of the zip are no images and were ignored");

    clip.inputs.masks = clip.inputs.video.clone();
    clip.video(&zip([("a/notes.txt".to_owned(), b"x".to_vec())]));
    let error = clip.error();
    assert_eq!((error.part, error.frame), (Part::Video, None));
    assert_eq!(error.message, "no file in the zip can be used; it has `a/notes.txt`");
}

#[test]
fn a_look_at_a_clip_tells_how_far_it_is_and_can_be_stopped() {
    let clip = Clip::new();
    for (max_frames, looks) in [(100, COUNT + 1), (4, 2 * COUNT + 1)] {
        let options = CaptureOptions { max_frames, max_side_px: 96 };
        let mut told = Vec::new();
        Capture::load(&clip.inputs, &options, &mut |read| {
            told.push(read);
            true
        })
        .unwrap();
        assert_eq!(told.len(), looks);
        assert!(told.is_sorted() && told[0] < 0.3 && told[looks - 1] == 1.0, "{told:?}");
        for last in [0, COUNT - 1, looks - 1] {
            let mut asked = 0;
            let stopped = Capture::load(&clip.inputs, &options, &mut |_| {
                asked += 1;
                asked <= last
            });
            assert!(matches!(stopped, Err(CaptureError::Stopped)), "{last}");
            assert_eq!(asked, last + 1);
        }
    }
}

#[test]
fn frames_at_uneven_times_count_once_each() {
    let clip = Clip::new();
    let uneven = "setpts='if(lt(N,4),N,if(lt(N,8),3*N,40+2*N))/25/TB'";
    clip.video(&video(&[&["-vf", uneven], &MKV[..]].concat()));
    assert_eq!(inspect(&clip.inputs).unwrap().frames, 12);
    assert_is_the_clip(&clip.load().unwrap(), 12);
}

/// As phones and `ffmpeg -c copy` cut: frames before the cut are still in the file, and what they refer to is not.
#[test]
fn a_video_that_was_cut_without_encoding_it_anew_is_whole() {
    let clip = Clip::new();
    #[rustfmt::skip]
    let open_gop = [
        "-f", "lavfi", "-i", "testsrc=size=64x96:rate=25:duration=6", "-map", "1:v", "-pix_fmt", "yuv420p",
        "-c:v", "libx264", "-g", "12", "-bf", "3", "-x264-params", "open-gop=1", "-f", "mp4",
    ];
    let whole = clip.add("whole.mp4", video(&open_gop)).unwrap();
    let mut ffmpeg = Command::new("ffmpeg");
    ffmpeg.args(["-v", "error", "-y", "-ss", "1.7", "-i"]).arg(whole).args(["-c", "copy", "-f", "mp4"]);
    assert!(ffmpeg.arg(&clip.inputs.video).status().unwrap().success());
    let mut ffprobe = Command::new("ffprobe");
    ffprobe.args([
        "-v",
        "quiet",
        "-count_frames",
        "-show_entries",
        "stream=nb_frames,nb_read_frames",
        "-of",
        "csv=p=0",
    ]);
    let told = String::from_utf8(ffprobe.arg(&clip.inputs.video).output().unwrap().stdout).unwrap();
    let [stored, shown] = told.trim().split(',').map(|n| n.parse().unwrap()).collect::<Vec<usize>>()[..] else {
        panic!("{told}")
    };
    assert!(shown < stored, "{shown} of {stored} frames are to be seen");
    clip.masks(&zip((0..shown).map(|i| (format!("{i}.png"), mask_png(0)))));
    let keypoints = |n: usize| clip.keypoints(keypoint_json(&vec![points(0); n]));
    keypoints(shown);
    clip.load().unwrap();
    let found = inspect(&clip.inputs).unwrap();
    assert_eq!(found.frames as usize, shown);
    // Not each FFmpeg does.
    let all =
        Command::new("ffmpeg").args(["-v", "error", "-i"]).arg(&clip.inputs.video).args(["-f", "null", "-"]).output();
    let complains = !all.unwrap().stderr.is_empty();
    let told = found.warnings.iter().any(|w| w.starts_with("video: FFmpeg complained"));
    assert_eq!(told, complains, "{:?}", found.warnings);
    // What is one short is to blame, and not what FFmpeg complains of.
    keypoints(shown - 1);
    let error = clip.error();
    assert_eq!(error.part, Part::Keypoints, "{error}");
}

#[test]
fn a_guessed_camera_has_the_pixels_of_the_video() {
    let clip = Clip::new();
    clip.video(&video(&[&["-vf", "setsar=4/3"], &MP4[..]].concat()));
    let capture = clip.load().unwrap();
    let (fx, fy) = (capture.camera.fx, capture.camera.fy);
    assert!(
        (fy / fx - 4.0 / 3.0).abs() < 1e-9 && (fy - 96.0 / 2.0 / 31f64.to_radians().tan()).abs() < 1e-6,
        "{fx} {fy}"
    );
    assert!(capture.warnings.iter().any(|w| w.contains("not square (4:3)")), "{:?}", capture.warnings);
}

#[test]
fn a_rotation_tag_turns_the_images() {
    let clip = Clip::new();
    let mut bytes = video(&MP4);
    // The display matrix of a `tkhd` box of version 0 lies 44 bytes after the start of its name, in 16.16 numbers.
    let matrix = bytes.windows(4).position(|w| w == b"tkhd").unwrap() + 44;
    for (i, value) in [0u32, 0x1_0000, 0, 0xffff_0000, 0].iter().enumerate() {
        bytes[matrix + 4 * i..matrix + 4 * i + 4].copy_from_slice(&value.to_be_bytes());
    }
    clip.video(&bytes);
    let error = clip.error();
    assert_eq!((error.part, error.frame), (Part::Masks, Some(0)));
    assert_eq!(error.message, "the mask is 64×96, turned against the video (`masks/0.png`)");
    assert_eq!(error.expected, "96×64, as the video");

    // Turned clockwise by 90°: (x, y) goes to (95 − y, x).
    let turned = |i| -> Vec<u8> {
        let mask = mask(i);
        (0..WIDTH)
            .flat_map(|y| (0..HEIGHT).map(move |x| (x, y)))
            .map(|(x, y)| mask[((95 - x) * WIDTH + y) as usize])
            .collect()
    };
    let masks = (0..COUNT).map(|i| png(&turned(i), HEIGHT, WIDTH, image::ExtendedColorType::L8));
    clip.masks(&zip(masks.enumerate().map(|(i, png)| (format!("{i}.png"), png))));
    let turn = |point: [f64; 3]| [96.0 - point[1], point[0], point[2]];
    let frames: Vec<Vec<_>> = (0..COUNT).map(|i| points(i).into_iter().map(turn).collect()).collect();
    clip.keypoints(keypoint_json(&frames));
    let capture = clip.load().unwrap();
    assert_eq!((capture.camera.width, capture.camera.height), (HEIGHT, WIDTH));
    for (i, frame) in capture.frames.iter().enumerate() {
        let set = frame.mask.iter().zip(frame.rgb.chunks(3)).filter(|(m, _)| **m == 255);
        let red: Vec<u32> = set.map(|(_, c)| u32::from(c[0])).collect();
        let mean = red.iter().sum::<u32>() / red.len() as u32;
        assert!((185..=215).contains(&mean), "frame {i}: the mask lies on red {mean}");
    }
}

#[test]
fn frames_are_thinned_and_scaled_with_their_keypoints_and_poses() {
    let mut clip = Clip::new();
    // Upright before a camera whose y runs down.
    let pose = |i: usize| {
        let mut pose = [i as f32; 72];
        pose[..3].copy_from_slice(&[std::f32::consts::PI, 0.0, 0.0]);
        pose
    };
    let poses: Vec<f32> = (0..COUNT).flat_map(pose).collect();
    let mut npz = NpzWriter::new(Cursor::new(Vec::new()));
    npz.add("poses", &[COUNT, 72], &poses).unwrap();
    npz.add("trans", &[COUNT, 3], &[[0.0f32, 0.0, 3.0]; COUNT].concat()).unwrap();
    clip.inputs.poses = clip.add("poses", npz.finish().unwrap().into_inner());
    let camera = r#"{"width": 64, "height": 96, "fx": 80, "fy": 81, "cx": 32, "cy": 48}"#;
    clip.inputs.camera = clip.add("camera", camera);
    let capture =
        Capture::load(&clip.inputs, &CaptureOptions { max_frames: 4, max_side_px: 48 }, &mut |_| true).unwrap();
    assert_eq!(capture.frames.iter().map(|f| f.index).collect::<Vec<_>>(), [0, 3, 6, 9]);
    let camera = &capture.camera;
    assert_eq!((camera.width, camera.height, camera.fx, camera.fy, camera.cx), (32, 48, 40.0, 40.5, 16.0));
    assert!(!capture.camera_estimated);
    let frame = &capture.frames[2];
    let want = points(6)[5];
    assert_eq!(frame.keypoints[5], [(want[0] / 2.0) as f32, (want[1] / 2.0) as f32, 0.9]);
    let inside = frame.mask.iter().filter(|&&v| v == 255).count();
    assert!((300..=340).contains(&inside), "{inside} of 10×32 pixels");
    assert_eq!(capture.poses.unwrap().poses.iter().map(|p| p[3]).collect::<Vec<_>>(), [0.0, 3.0, 6.0, 9.0]);
    let inspection = inspect(&clip.inputs).unwrap();
    assert!(inspection.has_camera && inspection.has_poses);
}

#[test]
fn frames_before_the_person_comes_are_left_out() {
    let clip = Clip::new();
    let black = png(&vec![0; (WIDTH * HEIGHT) as usize], WIDTH, HEIGHT, image::ExtendedColorType::L8);
    let masks = (0..COUNT).map(|i| if i < 3 { black.clone() } else { mask_png(i) });
    clip.masks(&zip(masks.enumerate().map(|(i, mask)| (format!("{i}.png"), mask))));
    // Somebody else, far from where the person will be.
    let people: Vec<_> = (0..COUNT).map(|i| if i < 3 { vec![[2.0, 2.0, 1.0]; 17] } else { points(i) }).collect();
    clip.keypoints(keypoint_json(&people));
    let warning = "masks: 3 of 12 are empty, the first of them 0: those frames are left out";
    assert_eq!(inspect(&clip.inputs).unwrap().warnings, [warning]);
    let capture = clip.load().unwrap();
    assert_eq!(capture.warnings, [warning]);
    assert_eq!(capture.frames.iter().map(|frame| frame.index as usize).collect::<Vec<_>>(), Vec::from_iter(3..COUNT));
    let whole = Clip::new().load().unwrap();
    for frame in &capture.frames {
        let same = &whole.frames[frame.index as usize];
        assert_eq!((&frame.rgb, &frame.keypoints), (&same.rgb, &same.keypoints));
    }
}

#[test]
fn the_frames_that_are_kept_have_somebody_in_them() {
    let clip = Clip::new();
    let (nobody, speck) = (mask_of(|_, _| false), mask_of(|x, y| (21..23).contains(&x) && (31..33).contains(&y)));
    let masks = |i| match i {
        0..4 => nobody.clone(),
        6 => speck.clone(),
        _ => mask_png(i),
    };
    clip.masks(&zip((0..COUNT).map(|i| (format!("{i}.png"), masks(i)))));
    let capture =
        Capture::load(&clip.inputs, &CaptureOptions { max_frames: 4, max_side_px: 48 }, &mut |_| true).unwrap();
    // Of 4 to 11 each second one, without the speck, of which half the size leaves nothing.
    assert_eq!(capture.frames.iter().map(|frame| frame.index).collect::<Vec<_>>(), [4, 8, 10]);
    let warnings = [
        "masks: 4 of 12 are empty, the first of them 0: those frames are left out",
        "keypoints: in 1 frames, the first of them 6, they are of somebody beside the mask: taken as not seen",
        "masks: nothing of the mask is left at 32×48 pixels in 1 of 4 frames, the first of them 6: left out",
    ];
    assert_eq!(capture.warnings, warnings);
    // Masks that are a video are gone through twice as well.
    let black = |i| if i < 4 { vec![0; (WIDTH * HEIGHT) as usize] } else { mask(i) };
    clip.masks(&encode((0..COUNT).map(black), "gray", &["-c:v", "ffv1", "-f", "matroska"]));
    let capture =
        Capture::load(&clip.inputs, &CaptureOptions { max_frames: 4, max_side_px: 48 }, &mut |_| true).unwrap();
    assert_eq!(capture.frames.iter().map(|frame| frame.index).collect::<Vec<_>>(), [4, 6, 8, 10]);
}

#[test]
fn some_frames_are_loaded_again_at_another_size() {
    let clip = Clip::new();
    let small = Capture::load(&clip.inputs, &CaptureOptions { max_frames: 4, max_side_px: 48 }, &mut |_| true).unwrap();
    assert_eq!(small.uploaded_side_px, 96);
    let large = Capture::load_frames(&clip.inputs, &[3, 9], 96, &mut |_| true).unwrap();
    assert_eq!(large.frames.iter().map(|f| f.index).collect::<Vec<_>>(), [3, 9]);
    assert_eq!((large.camera.width, large.camera.height), (64, 96));
    let whole = clip.load().unwrap();
    for frame in &large.frames {
        let same = &whole.frames[frame.index as usize];
        assert_eq!((frame.x0, frame.y0, &frame.rgb, &frame.mask), (same.x0, same.y0, &same.rgb, &same.mask));
    }
}
