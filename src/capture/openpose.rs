//! Zips of OpenPose's JSON, one file a frame; or of a single file, which may be our own JSON.

use std::path::Path;

use serde_json::Value;

use super::archive::Archive;
use super::keypoint_formats::{BODY25, Format};
use super::keypoints::{self, Keypoints, Point};
use super::{BadInput, CaptureError, Part, limits, text};
use crate::math::median;

const EXPECTED: &str = r#"OpenPose's JSON: {"people": [{"pose_keypoints_2d": [x, y, confidence, …]}]}"#;

#[derive(serde::Deserialize)]
struct File {
    people: Vec<Person>,
    /// Of the pictures that the points are of; other tools that write this form tell it.
    canvas_width: Option<f64>,
    canvas_height: Option<f64>,
}

#[derive(serde::Deserialize)]
struct Person {
    pose_keypoints_2d: Vec<Value>,
}

pub(super) fn read(path: &Path) -> Result<Keypoints, CaptureError> {
    let mut archive = Archive::open(Part::Keypoints, path, &[".json"])?;
    if archive.len() > limits::FRAMES {
        return Err(limits::too_many_frames(Part::Keypoints).into());
    }
    if archive.len() == 1 {
        let bytes = archive.read(0, limits::KEYPOINTS_BYTES)?;
        let whole = text::plain(Part::Keypoints, &bytes)?;
        if is_whole_clip(whole) {
            return Ok(keypoints::parse_json(whole)?);
        }
    }
    let mut frames = Vec::with_capacity(archive.len());
    let mut clip = Told::default();
    for frame in 0..archive.len() {
        let bytes = archive.read(frame, limits::OPENPOSE_FRAME_BYTES)?;
        let people = read_frame(text::plain(Part::Keypoints, &bytes)?, &mut clip);
        frames.push(people.map_err(|mut bad| {
            bad.message = format!("`{}`: {}", archive.name(frame), bad.message);
            bad.at(frame)
        })?);
    }
    let Told { format: Some(format), canvas } = clip else {
        return Err(BadInput::new(Part::Keypoints, "nobody is in any frame", "a person in most frames").into());
    };
    if format == BODY25 {
        check_not_body25b(&frames)?;
    }
    let canvas = canvas.flatten();
    Ok(Keypoints { format: format.used(), given: format, frames, canvas, gap: archive.gap(), warnings: Vec::new() })
}

/// What each frame tells of all.
#[derive(Default)]
struct Told {
    format: Option<Format>,
    /// The pictures' size, of the first frame.
    canvas: Option<Option<[f64; 2]>>,
}

/// OpenPose's experimental model has as many points in another order, without neck and middle of the hips: what should be the
/// middle of the shoulders and that of the hips is an eye and an elbow.
fn check_not_body25b(frames: &[Vec<Vec<Point>>]) -> Result<(), BadInput> {
    let off = |person: &Vec<Point>| {
        let place = |k: usize| (person[k][2] > 0.0).then(|| glam::DVec2::new(person[k][0], person[k][1]));
        let [neck, right, left, hips, right_hip, left_hip] = [1, 2, 5, 8, 9, 12].map(place);
        let (neck, hips) = (neck?, hips?);
        let off = neck.distance(right?.midpoint(left?)).max(hips.distance(right_hip?.midpoint(left_hip?)));
        Some(off / neck.distance(hips).max(1.0))
    };
    let off = frames.iter().flatten().filter_map(off);
    match median(off) {
        Some(off) if off > NOT_IN_THE_MIDDLE => Err(BadInput::new(
            Part::Keypoints,
            "points 1 and 8 do not lie between the shoulders and between the hips",
            "body25 (OpenPose's BODY_25), whose neck and middle of the hips they are; is this BODY_25B?",
        )),
        _ => Ok(()),
    }
}

/// In lengths of the trunk.
const NOT_IN_THE_MIDDLE: f64 = 0.4;

/// Whether a file holds the frames of a clip, as our JSON does, and not the people of one frame.
fn is_whole_clip(bytes: &[u8]) -> bool {
    #[derive(serde::Deserialize)]
    struct Keys {
        frames: Option<serde::de::IgnoredAny>,
    }
    serde_json::from_slice::<Keys>(bytes).is_ok_and(|keys| keys.frames.is_some())
}

fn read_frame(bytes: &[u8], clip: &mut Told) -> Result<Vec<Vec<Point>>, BadInput> {
    let file: File = serde_json::from_slice(bytes)
        .map_err(|e| BadInput::new(Part::Keypoints, format!("the JSON cannot be used: {e}"), EXPECTED))?;
    let canvas = file.canvas_width.zip(file.canvas_height).map(|(width, height)| [width, height]);
    if *clip.canvas.get_or_insert(canvas) != canvas {
        let message = "`canvas_width` and `canvas_height` are others than in the first frame";
        return Err(BadInput::new(Part::Keypoints, message, "points of pictures of one size"));
    }
    if file.people.len() > limits::PEOPLE {
        let message = format!("there are {} people", file.people.len());
        return Err(BadInput::new(Part::Keypoints, message, format!("at most {}", limits::PEOPLE)));
    }
    let mut people = Vec::with_capacity(file.people.len());
    for person in &file.people {
        let count = person.pose_keypoints_2d.len();
        let known = Format::of_count(count / 3).filter(|format| format.points * 3 == count);
        let Some(known) = known else {
            let expected = "75 (body25), 54 (coco18), 51 (coco17), 78 (halpe26) or 399 (wholebody133)";
            return Err(BadInput::new(Part::Keypoints, format!("`pose_keypoints_2d` has {count} numbers"), expected));
        };
        if *clip.format.get_or_insert(known) != known {
            let expected = "the same format in all frames";
            return Err(BadInput::new(Part::Keypoints, format!("the points are {}", known.name), expected));
        }
        people.push(known.to_used(read_points(&person.pose_keypoints_2d)?));
    }
    Ok(people)
}

fn read_points(values: &[Value]) -> Result<Vec<Point>, BadInput> {
    let mut points = vec![[0.0; 3]; values.len() / 3];
    for (i, value) in values.iter().enumerate() {
        points[i / 3][i % 3] = value.as_f64().ok_or_else(|| {
            let message = format!("point {} cannot be used: {value} is no number", i / 3);
            BadInput::new(Part::Keypoints, message, "three finite numbers: x, y and confidence")
        })?;
    }
    Ok(points)
}

#[cfg(test)]
mod tests {
    use super::super::keypoint_formats::COCO18;
    use super::*;

    #[test]
    fn people_are_read_and_their_format_is_told_by_the_count() {
        let mut clip = Told::default();
        let numbers = vec!["0.5"; 54].join(",");
        let text = format!(r#"{{"version": 1.3, "people": [{{"pose_keypoints_2d": [{numbers}], "x": []}}]}}"#);
        let people = read_frame(text.as_bytes(), &mut clip).unwrap();
        assert_eq!((people.len(), people[0].len(), clip.format), (1, 18, Some(COCO18)));
        assert!(read_frame(br#"{"people": []}"#, &mut clip).unwrap().is_empty());
        let other = text.replace("0.5,0.5,0.5,0.5,0.5,0.5,0.5,0.5,0.5", "0.5,0.5,0.5,0.5,0.5,0.5");
        assert!(read_frame(other.as_bytes(), &mut clip).unwrap_err().message.contains("36 numbers"));
    }

    #[test]
    fn what_is_no_number_is_named() {
        let mut numbers = vec!["1"; 75];
        numbers[7] = "null";
        let text = format!(r#"{{"people": [{{"pose_keypoints_2d": [{}]}}]}}"#, numbers.join(","));
        let error = read_frame(text.as_bytes(), &mut Told::default()).unwrap_err();
        assert!(error.message.starts_with("point 2 cannot be used: null"), "{error}");
        assert!(read_frame(b"{}", &mut Told::default()).unwrap_err().message.contains("people"));
    }

    #[test]
    fn points_of_another_model_are_not_taken_for_body25() {
        let mut person = vec![[0.0, 0.0, 0.9]; 25];
        for (k, [x, y]) in [
            (1, [50.0, 20.0]),
            (2, [42.0, 20.0]),
            (5, [58.0, 21.0]),
            (8, [50.0, 50.0]),
            (9, [45.0, 50.0]),
            (12, [55.0, 50.0]),
        ] {
            person[k] = [x, y, 0.9];
        }
        assert_eq!(check_not_body25b(&[vec![person.clone()]]), Ok(()));
        // Left eye and right elbow.
        (person[1], person[8]) = ([52.0, 5.0, 0.9], [35.0, 35.0, 0.9]);
        assert!(check_not_body25b(&[vec![person]]).unwrap_err().expected.contains("BODY_25B"));
    }

    #[test]
    fn a_clips_file_is_told_from_a_frames() {
        assert!(is_whole_clip(br#"{"format": "coco17", "frames": [[[1, 2]]]}"#));
        for other in [&br#"{"version": 1.3, "people": []}"#[..], b"[]", b"{", br#"{"frames": null}"#] {
            assert!(!is_whole_clip(other));
        }
    }
}
