//! 2D keypoints of every frame: our own JSON, plain or alone in a zip, or a zip of OpenPose's.

use std::cell::Cell;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

use serde::Deserializer as _;
use serde::de::{DeserializeSeed, Error as _, IgnoredAny, MapAccess, SeqAccess, Visitor};

use super::keypoint_formats::{Format, NAMES};
use super::{BadInput, CaptureError, Part, archive, limits, openpose, text};

/// x, y, confidence.
pub(super) type Point = [f64; 3];

/// Points as they were sent, but those of wider formats in body25's order; confidences within [0, 1].
#[derive(Debug)]
pub(super) struct Keypoints {
    pub format: Format,
    /// As they were sent.
    pub given: Format,
    /// `[N]` frames of people of `format.points` points each. A frame may have nobody.
    pub frames: Vec<Vec<Vec<Point>>>,
    /// Width and height of the pictures that they are of, where the file tells.
    pub canvas: Option<[f64; 2]>,
    /// The first number that the names of a zip's files leave out.
    pub gap: Option<u64>,
    pub warnings: Vec<String>,
}

/// Reads keypoints of either kind, told apart by content.
pub(super) fn read(path: &Path) -> Result<Keypoints, CaptureError> {
    let mut keypoints = if archive::is_zip(path)? { openpose::read(path)? } else { read_json(path)? };
    keypoints.check_confidences()?;
    keypoints.frames.iter_mut().flatten().flatten().for_each(settle_confidence);
    Ok(keypoints)
}

impl Keypoints {
    /// Numbers in place of a confidence that are none, as depths: they would say at random who is trusted.
    fn check_confidences(&mut self) -> Result<(), BadInput> {
        // Some detectors write −1 for what they have not found.
        let given = self.frames.iter().flatten().flatten().filter(|p| (p[0], p[1]) != (0.0, 0.0) && p[2] != -1.0);
        let (mut count, mut below, mut above, mut most) = (0, 0, 0, 0.0f64);
        for point in given {
            count += 1;
            below += usize::from(point[2] < 0.0);
            above += usize::from(point[2] > 1.5);
            most = most.max(point[2]);
        }
        if 20 * below > count {
            let message = format!("{below} of {count} confidences are below 0");
            let expected =
                "as the third number of a point how sure it is, from 0 to 1 (MediaPipe's `visibility`, not its `z`)";
            return Err(BadInput::new(Part::Keypoints, message, expected));
        }
        if 2 * above > count {
            self.warnings.push(format!("keypoints: confidences reach {most}: all above 1 count as 1"));
        }
        Ok(())
    }

    /// Brings points of pictures of another size to the video's, once.
    pub fn fit_canvas(&mut self, width: u32, height: u32, warnings: &mut Vec<String>) -> Result<(), BadInput> {
        let Some([across, down]) = self.canvas.take() else { return Ok(()) };
        let scale = [f64::from(width) / across, f64::from(height) / down];
        if scale == [1.0, 1.0] {
            return Ok(());
        }
        // Tools round the sides to what their networks take.
        if !(0.8..=1.25).contains(&(scale[0] / scale[1])) {
            let message = format!("they are of {across}×{down} pictures");
            return Err(BadInput::new(Part::Keypoints, message, format!("{width}×{height}, as the video")));
        }
        for point in self.frames.iter_mut().flatten().flatten() {
            (point[0], point[1]) = (scale[0] * point[0], scale[1] * point[1]);
        }
        warnings.push(format!("keypoints: they are of {across}×{down} pictures and were brought to {width}×{height}"));
        Ok(())
    }
}

/// Brings a confidence into [0, 1]. A point in the picture's very corner was not seen: detectors that leave an uncertain point
/// out write zeros for its place, and some keep its confidence.
fn settle_confidence(point: &mut Point) {
    let [x, y, confidence] = *point;
    point[2] = if (x, y) == (0.0, 0.0) { 0.0 } else { confidence.clamp(0.0, 1.0) };
}

const EXPECTED: &str = r#"JSON such as {"format": "coco17", "frames": [[[x, y, confidence] × 17] × N]}"#;

fn read_json(path: &Path) -> Result<Keypoints, CaptureError> {
    let open = |e| CaptureError::internal("cannot open the keypoints", e);
    let file = File::open(path).map_err(open)?;
    if file.metadata().map_err(open)?.len() > limits::KEYPOINTS_BYTES {
        let limit = format!("at most {} bytes", limits::KEYPOINTS_BYTES);
        return Err(BadInput::new(Part::Keypoints, "the file is too large", limit).into());
    }
    let mut reader = BufReader::new(file);
    let head = reader.fill_buf().map_err(open)?;
    let marked = head.len() - text::plain(Part::Keypoints, head)?.len();
    reader.consume(marked);
    Ok(parse_json(reader)?)
}

/// Where in the file the parser is.
#[derive(Default)]
struct Place {
    frame: Cell<Option<usize>>,
    point: Cell<Option<usize>>,
}

/// Our own JSON.
pub(super) fn parse_json(reader: impl std::io::Read) -> Result<Keypoints, BadInput> {
    let place = Place::default();
    let mut json = serde_json::Deserializer::from_reader(reader);
    let document = json.deserialize_map(DocumentVisitor(&place)).and_then(|document| json.end().map(|()| document));
    let (format, frames) = document.map_err(|e| complain(&place, &e))?;
    let Some(name) = format else { return Err(BadInput::new(Part::Keypoints, "`format` is missing", EXPECTED)) };
    let Some(format) = Format::named(&name) else {
        let name: String = name.chars().take(40).collect();
        return Err(BadInput::new(Part::Keypoints, format!("format `{name}` is unknown"), NAMES));
    };
    let Some(frames) = frames else { return Err(BadInput::new(Part::Keypoints, "`frames` is missing", EXPECTED)) };
    for (i, frame) in frames.iter().enumerate() {
        if frame.len() != format.points && !frame.is_empty() {
            let expected = format!("{} points, as {} has", format.points, format.name);
            return Err(BadInput::new(Part::Keypoints, format!("there are {} points", frame.len()), expected).at(i));
        }
    }
    // A detector that saw nobody wrote no points.
    let people = |frame: Vec<Point>| if frame.is_empty() { Vec::new() } else { vec![format.to_used(frame)] };
    let frames = frames.into_iter().map(people).collect();
    Ok(Keypoints { format: format.used(), given: format, frames, canvas: None, gap: None, warnings: Vec::new() })
}

/// A parser's error, with the frame and the point that it was at.
fn complain(place: &Place, error: &serde_json::Error) -> BadInput {
    let Some(frame) = place.frame.get() else {
        return BadInput::new(Part::Keypoints, format!("the JSON cannot be used: {error}"), EXPECTED);
    };
    match place.point.get() {
        Some(point) => {
            let expected = "three finite numbers: x, y and confidence";
            BadInput::new(Part::Keypoints, format!("point {point} cannot be used: {error}"), expected).at(frame)
        }
        None => BadInput::new(Part::Keypoints, format!("the frame cannot be used: {error}"), EXPECTED).at(frame),
    }
}

/// `{"format": …, "frames": …}`. The frames are read number by number, so that a hostile file cannot take more memory
/// than its points do, and an error has a place.
struct DocumentVisitor<'a>(&'a Place);

impl<'de> Visitor<'de> for DocumentVisitor<'_> {
    type Value = (Option<String>, Option<Vec<Vec<Point>>>);

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("an object with `format` and `frames`")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let (mut format, mut frames) = (None, None);
        while let Some(key) = map.next_key::<String>()? {
            match key.as_str() {
                "format" => format = Some(map.next_value()?),
                "frames" => frames = Some(map.next_value_seed(Frames(self.0))?),
                _ => drop(map.next_value::<IgnoredAny>()?),
            }
        }
        Ok((format, frames))
    }
}

/// A list whose elements are read by `element`, its index kept in a cell while it is being read.
fn read_list<'de, A, S>(
    mut seq: A,
    cell: &Cell<Option<usize>>,
    most: usize,
    element: impl Fn() -> S,
) -> Result<Vec<S::Value>, A::Error>
where
    A: SeqAccess<'de>,
    S: DeserializeSeed<'de>,
{
    let mut list = Vec::new();
    loop {
        cell.set(Some(list.len()));
        let Some(value) = seq.next_element_seed(element())? else { break };
        if list.len() == most {
            return Err(A::Error::custom(format!("there are more than {most}")));
        }
        list.push(value);
    }
    cell.set(None);
    Ok(list)
}

macro_rules! list_seed {
    ($seed:ident, $element:expr, $cell:ident, $most:expr, $value:ty, $what:literal) => {
        #[derive(Clone, Copy)]
        struct $seed<'a>(&'a Place);

        impl<'de> DeserializeSeed<'de> for $seed<'_> {
            type Value = Vec<$value>;

            fn deserialize<D: serde::Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
                deserializer.deserialize_seq(self)
            }
        }

        impl<'de> Visitor<'de> for $seed<'_> {
            type Value = Vec<$value>;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str($what)
            }

            fn visit_seq<A: SeqAccess<'de>>(self, seq: A) -> Result<Self::Value, A::Error> {
                read_list(seq, &self.0.$cell, $most, || $element(self.0))
            }
        }
    };
}

list_seed!(Frames, Points, frame, limits::FRAMES, Vec<Point>, "a list of frames");
list_seed!(Points, |_| OnePoint, point, 256, Point, "a list of points");

/// `[x, y, confidence]`; only numbers of JSON, which are finite.
struct OnePoint;

impl<'de> DeserializeSeed<'de> for OnePoint {
    type Value = Point;

    fn deserialize<D: serde::Deserializer<'de>>(self, deserializer: D) -> Result<Point, D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de> Visitor<'de> for OnePoint {
    type Value = Point;

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("[x, y, confidence]")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Point, A::Error> {
        let mut point = [0.0; 3];
        for (i, value) in point.iter_mut().enumerate() {
            *value = seq.next_element()?.ok_or_else(|| A::Error::invalid_length(i, &self))?;
        }
        match seq.next_element::<IgnoredAny>()? {
            None => Ok(point),
            Some(_) => Err(A::Error::custom("more than three values")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::keypoint_formats::{BODY25, COCO17};
    use super::*;

    fn document(point: &str) -> String {
        let frame = format!("[{}]", vec!["[1, 2.5, 1]"; 17].join(","));
        let odd = frame.replacen("[1, 2.5, 1]", point, 1);
        format!(r#"{{"extra": [[]], "format": "COCO-17", "frames": [{frame}, {odd}]}}"#)
    }

    #[test]
    fn a_document_with_extra_keys_is_read() {
        let keypoints = parse_json(document("[3, 4, 0]").as_bytes()).unwrap();
        assert_eq!((keypoints.format, keypoints.frames.len()), (COCO17, 2));
        assert_eq!(keypoints.frames[1][0][0], [3.0, 4.0, 0.0]);
    }

    #[test]
    fn wider_formats_become_body25_and_a_frame_without_points_has_nobody() {
        let frame = format!("[{}]", (0..33).map(|k| format!("[{k}, 0, 1]")).collect::<Vec<_>>().join(","));
        let text = format!(r#"{{"format": "mediapipe33", "frames": [{frame}, [], {frame}]}}"#);
        let keypoints = parse_json(text.as_bytes()).unwrap();
        assert_eq!((keypoints.format, keypoints.frames[1].len()), (BODY25, 0));
        let person = &keypoints.frames[2][0];
        assert_eq!((person.len(), person[0], person[1], person[2]), (25, [0.0, 0.0, 1.0], [0.0; 3], [12.0, 0.0, 1.0]));
    }

    #[test]
    fn a_point_without_a_place_was_not_seen() {
        for (given, confidence) in
            [([0.0, 0.0, 0.4], 0.0), ([0.0, 7.0, 0.4], 0.4), ([5.0, 0.0, 3.0], 1.0), ([5.0, 7.0, -1.0], 0.0)]
        {
            let mut point = given;
            settle_confidence(&mut point);
            assert_eq!(point, [given[0], given[1], confidence]);
        }
    }

    #[test]
    fn points_that_are_no_numbers_are_named() {
        for bad in ["[NaN, 1, 1]", r#"["1", 1, 1]"#, "[null, 1, 1]", "[1, 1]", "[1, 1, 1, 1]", "null", "[1e999, 1, 1]"]
        {
            let error = parse_json(document(bad).as_bytes()).unwrap_err();
            assert_eq!(error.frame, Some(1), "{bad}: {error}");
            assert!(error.message.starts_with("point 0 cannot be used"), "{bad}: {error}");
        }
    }

    #[test]
    fn wrong_counts_and_documents_are_refused() {
        let error = parse_json(document("[1, 1, 1], [1, 1, 1]").as_bytes()).unwrap_err().to_string();
        assert_eq!(error, "keypoints, frame 1: there are 18 points (expected 17 points, as coco17 has)");
        for (text, message) in [
            (r#"{"frames": []}"#, "`format` is missing"),
            (r#"{"format": "coco17"}"#, "`frames` is missing"),
            (r#"{"format": "coco19", "frames": []}"#, "format `coco19` is unknown"),
            ("[]", "the JSON cannot be used"),
            ("hello", "the JSON cannot be used"),
            (r#"{"format": "coco17", "frames": {}}"#, "the JSON cannot be used"),
        ] {
            let error = parse_json(text.as_bytes()).unwrap_err();
            assert!(error.message.starts_with(message), "{text}: {error}");
        }
    }

    #[test]
    fn deep_nesting_is_an_error_and_no_overflow() {
        let text = format!(r#"{{"x": {}"#, "[".repeat(100_000));
        assert!(parse_json(text.as_bytes()).is_err());
    }
}
