//! Bodies as generated clients must know them: bytes are not text, and of a request's content types they speak the first.

use utoipa::openapi::path::Operation;
use utoipa::openapi::{Content, KnownFormat, ObjectBuilder, RefOr, SchemaFormat, Type};
use yaml_serde::Value;

/// Shows each body with its status, which a request lacks, and its content type.
pub(super) fn each(operation: &mut Operation, mut visit: impl FnMut(&str, &str, &mut Content)) {
    if let Some(RefOr::T(body)) = &mut operation.request_body {
        for (kind, content) in &mut body.content {
            if let RefOr::T(content) = content {
                visit("", kind, content);
            }
        }
    }
    for (status, response) in &mut operation.responses.responses {
        let RefOr::T(response) = response else { continue };
        for (kind, content) in &mut response.content {
            if let RefOr::T(content) = content {
                visit(status, kind, content);
            }
        }
    }
}

/// Clients decode what is not said to be binary. Handlers cannot say it: to the library bytes are a list of numbers.
pub(super) fn complete(operation: &mut Operation) {
    each(operation, |status, kind, content| {
        if is_bytes(status, kind) {
            let binary = SchemaFormat::KnownFormat(KnownFormat::Binary);
            let schema = ObjectBuilder::new().schema_type(Type::String).format(Some(binary)).build();
            content.schema = Some(RefOr::T(schema.into()));
        }
    });
}

/// A range of a text may end within a character.
pub(super) fn is_bytes(status: &str, kind: &str) -> bool {
    let is_text = kind.starts_with("text/") || kind.ends_with("json") || kind == "application/yaml";
    status == "206" || !(is_text || kind == FORM)
}

const FORM: &str = "multipart/form-data";

/// A clip's files come as a form; the library sorts content types by their names.
pub(super) fn put_forms_first(api: &mut Value) {
    let paths = api.get_mut("paths").and_then(Value::as_mapping_mut);
    let operations = paths.into_iter().flat_map(|paths| paths.values_mut()).filter_map(Value::as_mapping_mut);
    for operation in operations.flat_map(|item| item.values_mut()) {
        let content = operation.get_mut("requestBody").and_then(|body| body.get_mut("content"));
        let Some(content) = content.and_then(Value::as_mapping_mut) else { continue };
        if let Some(form) = content.remove(FORM) {
            let others = std::mem::take(content);
            content.insert(FORM.into(), form);
            content.extend(others);
        }
    }
}
