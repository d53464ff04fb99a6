//! A camera's JSON in all forms that people's tools write, the same beside a clip and in a request.

use serde_json::{Map, Value};

use super::{Camera, IDENTITY};
use crate::json::JsonError;

const EXPECTED: &str = "JSON with width, height, fx, fy, cx, cy in pixels";
const OF_THE_LENS: &str = "k1, k2, p1, p2, k3 (Brown's model, no fisheye)";

/// What is read.
const NAMES: [&str; 14] =
    ["width", "height", "fx", "fy", "cx", "cy", "distortion", "k1", "k2", "k3", "p1", "p2", "rotation", "translation"];

/// Reads a camera. What else stands beside it is its own, but for what is nearly one of its names or tells of a lens. Ranges are
/// for the caller, and whether the rotation is one.
///
/// # Errors
/// [`JsonError`] for what is missing or has another type or length, and for a name that would be left out without a word.
pub fn from_json(json: &Map<String, Value>) -> Result<Camera, JsonError> {
    check_names(json)?;
    Ok(Camera {
        width: size(json, "width")?,
        height: size(json, "height")?,
        fx: number(json, "fx")?,
        fy: number(json, "fy")?,
        cx: number(json, "cx")?,
        cy: number(json, "cy")?,
        distortion: distortion(json)?,
        rotation: vector(json, "rotation")?.unwrap_or(IDENTITY),
        translation: vector(json, "translation")?.unwrap_or_default(),
    })
}

fn wrong(key: &str, message: impl Into<String>, expected: impl Into<String>) -> JsonError {
    JsonError { field: Some(key.into()), message: message.into(), expected: Some(expected.into()) }
}

/// Refuses a lens under another name, and a name that is nearly one of ours.
fn check_names(json: &Map<String, Value>) -> Result<(), JsonError> {
    for (key, value) in json.iter().filter(|(key, _)| !NAMES.contains(&key.as_str())) {
        let lower = key.to_lowercase();
        let model = value.as_str().unwrap_or("").to_lowercase();
        if ["fisheye", "equidistant", "omni", "kannala"].iter().any(|name| model.contains(name)) {
            return Err(wrong(key, format!("`{key}` is {}", short(value)), OF_THE_LENS));
        }
        if ["k4", "k5", "k6"].contains(&lower.as_str()) {
            return Err(wrong(key, format!("there is a `{key}`"), OF_THE_LENS));
        }
        let is_lens = ["dist_", "distc", "distort", "distors"].iter().any(|start| lower.starts_with(start))
            || ["d", "dist", "coeffs", "coefficients", "params"].contains(&lower.as_str());
        let is_nothing = |value: &Value| value.is_null() || value.as_f64() == Some(0.0);
        let says_none =
            value.is_string() || is_nothing(value) || value.as_array().is_some_and(|list| list.iter().all(is_nothing));
        if is_lens && !says_none {
            let expected = format!("a lens as `distortion`: {OF_THE_LENS}");
            return Err(wrong(key, format!("there is a `{key}`, which is not read"), expected));
        }
        let is_near =
            |name: &&&str| lower == **name || name.len() > 7 && strsim::damerau_levenshtein(&lower, name) <= 2;
        if let Some(near) = NAMES.iter().find(is_near) {
            return Err(wrong(key, format!("there is a `{key}`"), format!("`{near}`, if that is meant")));
        }
    }
    Ok(())
}

fn number(json: &Map<String, Value>, key: &str) -> Result<f64, JsonError> {
    match json.get(key) {
        None => {
            let message = format!("`{key}` is missing");
            Err(JsonError { field: None, message, expected: Some(EXPECTED.into()) })
        }
        // Numbers of JSON are finite.
        Some(value) => value.as_f64().ok_or_else(|| wrong(key, format!("`{key}` is {}", short(value)), "a number")),
    }
}

fn size(json: &Map<String, Value>, key: &str) -> Result<u32, JsonError> {
    let value = number(json, key)?;
    if value.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&value) {
        return Ok(value as u32);
    }
    Err(wrong(key, format!("`{key}` is {value}"), "a whole number of pixels"))
}

fn short(value: &Value) -> String {
    value.to_string().chars().take(60).collect()
}

/// Numbers of a list, nested or not.
fn numbers(key: &str, value: &Value) -> Result<Vec<f64>, JsonError> {
    let is_wrong = || wrong(key, format!("`{key}` is {}", short(value)), "a list of numbers");
    let list = value.as_array().ok_or_else(is_wrong)?;
    let mut flat = Vec::new();
    for item in list {
        match item.as_array() {
            Some(row) => flat.extend(row.iter().map(Value::as_f64)),
            None => flat.push(item.as_f64()),
        }
    }
    flat.into_iter().collect::<Option<Vec<f64>>>().ok_or_else(is_wrong)
}

/// `distortion: [k1, k2, p1, p2, k3]` (shorter is fine), `distortion: {k1: …}`, or `k1` … beside the other fields.
fn distortion(json: &Map<String, Value>) -> Result<[f64; 5], JsonError> {
    const NAMES: [&str; 5] = ["k1", "k2", "p1", "p2", "k3"];
    let wrong = |message: String| wrong("distortion", message, OF_THE_LENS);
    let mut coefficients = [0.0; 5];
    let named = match json.get("distortion") {
        None | Some(Value::Null) => json,
        Some(Value::Object(named)) => {
            if let Some(other) = named.keys().find(|key| !NAMES.contains(&key.as_str())) {
                return Err(wrong(format!("`distortion` has a `{other}`")));
            }
            named
        }
        Some(list) => {
            let list = numbers("distortion", list)?;
            if list.len() > 5 {
                return Err(wrong(format!("`distortion` has {} numbers", list.len())));
            }
            coefficients[..list.len()].copy_from_slice(&list);
            return Ok(coefficients);
        }
    };
    for (name, coefficient) in NAMES.iter().zip(&mut coefficients) {
        if named.contains_key(*name) {
            *coefficient = number(named, name)?;
        }
    }
    Ok(coefficients)
}

fn vector<const N: usize>(json: &Map<String, Value>, key: &str) -> Result<Option<[f64; N]>, JsonError> {
    let Some(value) = json.get(key).filter(|value| !value.is_null()) else { return Ok(None) };
    let list = numbers(key, value)?;
    let count = list.len();
    let wrong = |_| wrong(key, format!("`{key}` has {count} numbers"), format!("{N} numbers"));
    list.try_into().map(Some).map_err(wrong)
}
