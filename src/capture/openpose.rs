//! Zips of OpenPose's JSON, one file a frame; or of a single file, which may be our own JSON.

use std::path::Path;

use serde_json::Value;

use super::archive::Archive;
use super::keypoint_formats::Format;
use super::keypoints::{self, Keypoints, Point};
use super::{BadInput, CaptureError, Part, limits};

const EXPECTED: &str = r#"OpenPose's JSON: {"people": [{"pose_keypoints_2d": [x, y, confidence, …]}]}"#;

#[derive(serde::Deserialize)]
struct File {
    people: Vec<Person>,
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
        if is_whole_clip(&bytes) {
            return Ok(keypoints::parse_json(&bytes[..])?);
        }
    }
    let mut frames = Vec::with_capacity(archive.len());
    let mut format = None;
    for frame in 0..archive.len() {
        let bytes = archive.read(frame, limits::OPENPOSE_FRAME_BYTES)?;
        frames.push(read_frame(&bytes, &mut format).map_err(|bad| bad.at(frame))?);
    }
    let Some(format) = format else {
        return Err(BadInput::new(Part::Keypoints, "nobody is in any frame", "a person in most frames").into());
    };
    Ok(Keypoints { format: format.used(), given: format, frames, warnings: Vec::new() })
}

/// Whether a file holds the frames of a clip, as our JSON does, and not the people of one frame.
fn is_whole_clip(bytes: &[u8]) -> bool {
    #[derive(serde::Deserialize)]
    struct Keys {
        frames: Option<serde::de::IgnoredAny>,
    }
    serde_json::from_slice::<Keys>(bytes).is_ok_and(|keys| keys.frames.is_some())
}

fn read_frame(bytes: &[u8], format: &mut Option<Format>) -> Result<Vec<Vec<Point>>, BadInput> {
    let file: File = serde_json::from_slice(bytes)
        .map_err(|e| BadInput::new(Part::Keypoints, format!("the JSON cannot be used: {e}"), EXPECTED))?;
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
        if *format.get_or_insert(known) != known {
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
        let mut format = None;
        let numbers = vec!["0.5"; 54].join(",");
        let text = format!(r#"{{"version": 1.3, "people": [{{"pose_keypoints_2d": [{numbers}], "x": []}}]}}"#);
        let people = read_frame(text.as_bytes(), &mut format).unwrap();
        assert_eq!((people.len(), people[0].len(), format), (1, 18, Some(COCO18)));
        assert!(read_frame(br#"{"people": []}"#, &mut format).unwrap().is_empty());
        let other = text.replace("0.5,0.5,0.5,0.5,0.5,0.5,0.5,0.5,0.5", "0.5,0.5,0.5,0.5,0.5,0.5");
        assert!(read_frame(other.as_bytes(), &mut format).unwrap_err().message.contains("36 numbers"));
    }

    #[test]
    fn what_is_no_number_is_named() {
        let mut numbers = vec!["1"; 75];
        numbers[7] = "null";
        let text = format!(r#"{{"people": [{{"pose_keypoints_2d": [{}]}}]}}"#, numbers.join(","));
        let error = read_frame(text.as_bytes(), &mut None).unwrap_err();
        assert!(error.message.starts_with("point 2 cannot be used: null"), "{error}");
        assert!(read_frame(b"{}", &mut None).unwrap_err().message.contains("people"));
    }

    #[test]
    fn a_clips_file_is_told_from_a_frames() {
        assert!(is_whole_clip(br#"{"format": "coco17", "frames": [[[1, 2]]]}"#));
        for other in [&br#"{"version": 1.3, "people": []}"#[..], b"[]", b"{", br#"{"frames": null}"#] {
            assert!(!is_whole_clip(other));
        }
    }
}
