//! JSON from outside: one whole object, and a mistake is told with its field and what was expected, in words of JSON.

use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

/// Why a text is not the object that was asked for.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct JsonError {
    /// The path of the field at fault, where one is.
    pub field: Option<String>,
    pub message: String,
    pub expected: Option<String>,
}

/// Reads one object and nothing after it. serde takes a struct's fields from a list, too, by their order, which nobody means.
///
/// # Errors
/// [`JsonError`] for what is no JSON, no object, or not of this type.
pub fn object<T: DeserializeOwned>(json: &[u8]) -> Result<T, JsonError> {
    if json.iter().find(|byte| !byte.is_ascii_whitespace()).is_some_and(|&first| first != b'{') {
        return Err(JsonError {
            field: None,
            message: "the JSON is no object".into(),
            expected: Some("an object".into()),
        });
    }
    let mut reader = serde_json::Deserializer::from_slice(json);
    let value = serde_path_to_error::deserialize(&mut reader).map_err(|error| explained(&error))?;
    reader.end().map_err(|error| JsonError {
        field: None,
        message: without_position(&error.to_string()).into(),
        expected: Some("nothing after the object".into()),
    })?;
    Ok(value)
}

/// The fields of a value that should be an object.
///
/// # Errors
/// [`JsonError`] for all else.
pub fn fields(json: Value) -> Result<Map<String, Value>, JsonError> {
    match json {
        Value::Object(fields) => Ok(fields),
        _ => Err(JsonError { field: None, message: "it is no object".into(), expected: Some("an object".into()) }),
    }
}

fn explained(error: &serde_path_to_error::Error<serde_json::Error>) -> JsonError {
    let message = in_plain_words(&error.inner().to_string());
    let expected = message.split_once("expected ").map(|(_, rest)| rest.to_string());
    JsonError { field: field(&error.path().to_string()), message, expected }
}

/// `?` stands for what the reader could not name.
fn field(path: &str) -> Option<String> {
    let path = path.trim_end_matches('?').trim_end_matches('.');
    (!path.is_empty()).then(|| path.to_string())
}

/// serde_json ends its messages with the place in the text, which says little about a small object.
fn without_position(message: &str) -> &str {
    message.split(" at line ").next().unwrap_or(message)
}

/// serde names the types of Rust.
fn in_plain_words(message: &str) -> String {
    let message = without_position(message);
    let Some((before, expected)) = message.rsplit_once("expected ") else { return message.into() };
    let words = match expected {
        "u8" | "u16" | "u32" | "u64" | "usize" => "a whole number from 0 on",
        "i8" | "i16" | "i32" | "i64" | "isize" => "a whole number",
        "f32" | "f64" => "a number",
        "a sequence" => "a list",
        "a map" => "an object",
        of_rust if of_rust.starts_with("struct ") => "an object",
        plain => plain,
    };
    format!("{before}expected {words}")
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    #[derive(Debug, PartialEq, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Asked {
        count: u32,
        #[serde(default)]
        inside: Option<Inside>,
        #[serde(default)]
        list: Vec<f64>,
        #[serde(default)]
        names: BTreeMap<String, bool>,
    }

    #[derive(Debug, PartialEq, serde::Deserialize)]
    struct Inside {
        size: f64,
    }

    #[test]
    fn one_whole_object_is_read_and_nothing_else() {
        let read = object::<Asked>(b" {\"count\": 3} \n").unwrap();
        assert_eq!(read, Asked { count: 3, inside: None, list: Vec::new(), names: BTreeMap::new() });
        for (json, field, expected) in [
            ("[3, null]", None, "an object"),
            ("3", None, "an object"),
            (r#"{"count": 3} more"#, None, "nothing after the object"),
            (r#"{"count": "3"}"#, Some("count"), "a whole number from 0 on"),
            (r#"{"count": 3, "inside": 1}"#, Some("inside"), "an object"),
            (r#"{"count": 3, "inside": {"size": "x"}}"#, Some("inside.size"), "a number"),
            (r#"{"count": 3, "list": 1}"#, Some("list"), "a list"),
            (r#"{"count": 3, "list": [true]}"#, Some("list[0]"), "a number"),
            (r#"{"count": 3, "names": 1}"#, Some("names"), "an object"),
        ] {
            let error = object::<Asked>(json.as_bytes()).unwrap_err();
            assert_eq!((error.field.as_deref(), error.expected.as_deref()), (field, Some(expected)), "{json}: {error}");
            assert!(!error.message.contains("line"), "{error}");
        }
        for cut in ["", "{", r#"{"count"#, r#"{"count": 3, "inside": {"#] {
            let error = object::<Asked>(cut.as_bytes()).unwrap_err();
            assert!(error.message.contains("EOF"), "{cut}: {error}");
            assert!(error.field.as_deref().is_none_or(|field| !field.contains('?')), "{cut}: {:?}", error.field);
        }
    }
}
