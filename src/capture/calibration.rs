//! The camera that came with a clip, or the guess where none came.

use std::io::Read;
use std::path::Path;

use serde_json::{Map, Value};

use super::{BadInput, CaptureError, Part, limits, text};
use crate::camera::{self, Camera, is_rotation};
use crate::json::JsonError;

/// Horizontal field of view along the longer side of a phone's main camera while filming (26–28 mm equivalent, with
/// the usual crop for stabilisation): 62°.
const GUESSED_FIELD_OF_VIEW: f64 = 62.0 * std::f64::consts::PI / 180.0;

/// A camera for images of this size of which nothing is known but the width of a pixel over its height.
pub(super) fn guess(width: u32, height: u32, pixel_aspect: f64) -> Camera {
    // In heights of a pixel.
    let longer = (f64::from(width) * pixel_aspect).max(f64::from(height));
    let focal = 0.5 * longer / (0.5 * GUESSED_FIELD_OF_VIEW).tan();
    Camera::pinhole(width, height, [focal / pixel_aspect, focal, 0.5 * f64::from(width), 0.5 * f64::from(height)])
}

/// A camera's file, in all forms that are taken beside a clip.
pub fn read(path: &Path) -> Result<Camera, CaptureError> {
    let mut text = Vec::new();
    let file = std::fs::File::open(path).map_err(|e| CaptureError::internal("cannot open the camera", e))?;
    let mut file = file.take(limits::CAMERA_BYTES + 1);
    file.read_to_end(&mut text).map_err(|e| CaptureError::internal("cannot read the camera", e))?;
    if text.len() as u64 > limits::CAMERA_BYTES {
        return Err(bad("the file is too large", format!("at most {} bytes", limits::CAMERA_BYTES)).into());
    }
    Ok(parse(&text)?)
}

fn bad(message: impl Into<String>, expected: impl Into<String>) -> BadInput {
    BadInput::new(Part::Camera, message, expected)
}

fn parse(text: &[u8]) -> Result<Camera, BadInput> {
    let text = text::plain(Part::Camera, text)?;
    let json: Map<String, Value> =
        serde_json::from_slice(text).map_err(|e| bad(format!("the JSON cannot be used: {e}"), "an object"))?;
    let camera = camera::from_json(&json)
        .map_err(|JsonError { message, expected, .. }| bad(message, expected.unwrap_or_default()))?;
    check(&camera)?;
    Ok(camera)
}

/// Whether it can be one that films a person, and of the pictures that it says.
fn check(camera: &Camera) -> Result<(), BadInput> {
    for (key, side) in [("width", camera.width), ("height", camera.height)] {
        if !(1..=limits::SIDE_PX).contains(&side) {
            let expected = format!("a whole number of pixels from 1 to {}", limits::SIDE_PX);
            return Err(bad(format!("`{key}` is {side}"), expected));
        }
    }
    let longer = f64::from(camera.width.max(camera.height));
    let (least, most) = (0.2 * longer, 20.0 * longer);
    for (key, value) in [("fx", camera.fx), ("fy", camera.fy)] {
        if !(least..=most).contains(&value) {
            let expected = format!("pixels, from {least} to {most} for these images");
            return Err(bad(format!("the focal length `{key}` is {value}"), expected));
        }
    }
    for (key, value, side) in [("cx", camera.cx, camera.width), ("cy", camera.cy, camera.height)] {
        let side = f64::from(side);
        if !(-0.5 * side..=1.5 * side).contains(&value) {
            let expected = format!("pixels, near {}", 0.5 * side);
            return Err(bad(format!("the principal point `{key}` is {value}"), expected));
        }
    }
    if !is_rotation(&camera.rotation) {
        return Err(bad("`rotation` is no rotation", "3×3 orthonormal rows (row-major) with determinant 1"));
    }
    check_middle(camera)?;
    if !(0.5..=2.0).contains(&(camera.fx / camera.fy)) {
        return Err(bad(format!("`fx` is {}, `fy` is {}", camera.fx, camera.fy), "focal lengths within a factor of 2"));
    }
    Ok(())
}

/// A principal point that lies in the middle of images of another size is of those, and so is the focal length.
fn check_middle(camera: &Camera) -> Result<(), BadInput> {
    let scale = [2.0 * camera.cx / f64::from(camera.width), 2.0 * camera.cy / f64::from(camera.height)];
    let other = scale[0] > 1.25 || scale[0] < 0.8;
    if !other || (scale[0] - scale[1]).abs() > 0.03 * scale[0] {
        return Ok(());
    }
    let (cx, cy, times) = (camera.cx, camera.cy, (1e3 * scale[0]).round() / 1e3);
    let message = format!("the principal point ({cx}, {cy}) is the middle of images {times} times as large");
    let expected =
        format!("numbers of the {}×{} images: divide fx, fy, cx and cy by {times}", camera.width, camera.height);
    Err(bad(message, expected))
}

/// The camera must be of the video's very images.
pub(super) fn check_size(camera: &Camera, width: u32, height: u32) -> Result<(), BadInput> {
    if (camera.width, camera.height) == (width, height) {
        return Ok(());
    }
    let ratio = f64::from(camera.width) / f64::from(width);
    let hint = if (camera.width, camera.height) == (height, width) {
        "; turned against the video, as it is shown where a rotation tag turns it: swap width and height, and fx and fy, and turn \
         cx and cy with the images"
            .to_owned()
    } else if (ratio - f64::from(camera.height) / f64::from(height)).abs() < 1e-9 {
        format!("; divide width, height, fx, fy, cx and cy by {ratio} if the video was scaled")
    } else {
        String::new()
    };
    let message = format!("the camera is of {}×{} images{hint}", camera.width, camera.height);
    Err(bad(message, format!("{width}×{height}, the video's size")))
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = r#"{"width": 360, "height": 640, "fx": 600, "fy": 600.5, "cx": 180, "cy": 320, "model": "x"}"#;

    fn with(key: &str, value: &str) -> Result<Camera, BadInput> {
        let mut json: Map<String, Value> = serde_json::from_str(GOOD).unwrap();
        json.insert(key.to_owned(), serde_json::from_str(value).unwrap());
        parse(serde_json::to_string(&json).unwrap().as_bytes())
    }

    #[test]
    fn a_plain_camera_and_all_ways_to_write_distortion() {
        let camera = parse(GOOD.as_bytes()).unwrap();
        assert_eq!((camera.width, camera.fy, camera.distortion), (360, 600.5, [0.0; 5]));
        let want = [0.1, -0.2, 0.0, 0.0, 0.0];
        assert_eq!(with("distortion", "[0.1, -0.2]").unwrap().distortion, want);
        assert_eq!(with("distortion", "[[0.1, -0.2, 0, 0, 0]]").unwrap().distortion, want);
        assert_eq!(with("distortion", r#"{"k1": 0.1, "k2": -0.2}"#).unwrap().distortion, want);
        assert_eq!(with("k3", "0.5").unwrap().distortion, [0.0, 0.0, 0.0, 0.0, 0.5]);
    }

    #[test]
    fn what_no_camera_has_is_refused() {
        for (key, value, message) in [
            ("fx", "0", "the focal length `fx` is 0"),
            ("fx", "-600", "the focal length `fx` is -600"),
            ("fy", "\"600\"", "`fy` is \"600\""),
            ("fy", "1e9", "the focal length `fy` is 1000000000"),
            ("cx", "null", "`cx` is null"),
            ("cy", "5000", "the principal point `cy` is 5000"),
            ("width", "360.5", "`width` is 360.5"),
            ("width", "-1", "`width` is -1"),
            ("distortion", "[1, 2, 3, 4, 5, 6]", "`distortion` has 6 numbers"),
            ("distortion", "[null]", "`distortion` is [null]"),
            ("distortion", r#"{"k1": 0.1, "k4": 0.2}"#, "`distortion` has a `k4`"),
            ("k4", "0.2", "there is a `k4`"),
            ("dist_coeffs", "[0.1, 0, 0, 0, 0]", "there is a `dist_coeffs`, which is not read"),
            ("D", "[0.1]", "there is a `D`, which is not read"),
            ("model", "\"SIMPLE_RADIAL_FISHEYE\"", "`model` is \"SIMPLE_RADIAL_FISHEYE\""),
            ("rotaton", "[]", "there is a `rotaton`"),
            ("K1", "0.1", "there is a `K1`"),
            ("rotation", "[[1, 0, 0], [0, 1, 0], [0, 0, 2]]", "`rotation` is no rotation"),
            ("rotation", "[1, 0, 0, 0, 1, 0, 0, 0, -1]", "`rotation` is no rotation"),
            ("rotation", "[1, 0]", "`rotation` has 2 numbers"),
            ("translation", "[1]", "`translation` has 1 numbers"),
        ] {
            let error = with(key, value).unwrap_err();
            assert!(error.message.starts_with(message), "{key} {value}: {error}");
        }
        assert!(parse(b"[]").unwrap_err().message.starts_with("the JSON cannot be used"));
        assert_eq!(parse(b"{}").unwrap_err().message, "`width` is missing");
    }

    #[test]
    fn what_says_that_there_is_no_lens_is_none() {
        for (key, value) in [
            ("dist_coeffs", "[0, 0, 0, 0]"),
            ("distortion_model", "\"plumb_bob\""),
            ("D", "[]"),
            ("date", "\"today\""),
            ("distance", "3.2"),
            ("weight", "70"),
        ] {
            assert!(with(key, value).is_ok(), "{key}");
        }
    }

    #[test]
    fn numbers_of_images_of_another_size_are_told_by_their_middle() {
        for (scale, told) in [(2.0, "divide fx, fy, cx and cy by 2"), (0.5, "by 0.5"), (1.2, ""), (0.9, "")] {
            let text = GOOD
                .replace("180", &(180.0 * scale).to_string())
                .replace("\"cy\": 320", &format!("\"cy\": {}", 320.0 * scale));
            match parse(text.as_bytes()) {
                Err(error) => assert!(!told.is_empty() && error.expected.contains(told), "{error}"),
                Ok(_) => assert!(told.is_empty(), "{scale}"),
            }
        }
        assert!(with("cx", "340").is_ok(), "of images that were cut at one side");
    }

    #[test]
    fn a_camera_of_other_images_is_explained() {
        let camera = parse(GOOD.as_bytes()).unwrap();
        assert!(check_size(&camera, 360, 640).is_ok());
        let error = check_size(&camera, 180, 320).unwrap_err().to_string();
        assert!(error.contains("360×640 images; divide width, height, fx, fy, cx and cy by 2"), "{error}");
        assert!(check_size(&camera, 640, 360).unwrap_err().message.contains("rotation tag"));
    }

    #[test]
    fn the_guess_is_a_phone() {
        let camera = guess(1080, 1920, 1.0);
        assert!((camera.fx / 1920.0 - 0.832).abs() < 1e-3 && camera.fx == camera.fy);
        assert_eq!((camera.cx, camera.cy), (540.0, 960.0));
    }
}
