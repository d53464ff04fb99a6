//! Errors that follow from what a route is, not from what its handler does: who may call, the body's size and pace, the
//! disk. Handlers document their own.

use utoipa::openapi::header::HeaderBuilder;
use utoipa::openapi::path::{Operation, ParameterIn};
use utoipa::openapi::{ContentBuilder, ObjectBuilder, Ref, RefOr, Response, ResponseBuilder, Type};

/// Adds what the handler's own documentation does not name.
pub(super) fn complete(path: &str, operation: &mut Operation) {
    let is_guarded = super::is_guarded(path);
    let id = operation.operation_id.as_deref().unwrap_or("");
    let json_body = operation.request_body.is_some() && id != "uploads_append";
    let writes = path.starts_with("/v1/")
        && (json_body
            || ["append", "remove", "cancel", "retry", "delete", "overridden"].iter().any(|verb| id.ends_with(verb)));
    let has_query = operation.parameters.iter().flatten().any(|parameter| match parameter {
        RefOr::T(parameter) => parameter.parameter_in == ParameterIn::Query,
        RefOr::Ref(_) => false,
    });
    let is_tus = id.starts_with("uploads_") && id != "uploads_options";
    let is_any_tus = id == "uploads_overridden";
    let general = [
        (is_guarded, 401, "No key was sent where one is needed, or one that is unknown, expired or revoked"),
        (is_guarded, 403, "The key lacks the scope, or the caller is not one whom this server answers"),
        (is_guarded, 429, "More requests a minute than the key allows"),
        (is_guarded, 500, "The server failed; its log has the cause under the request's id"),
        (json_body, 400, "The body is malformed: the answer names the field"),
        (json_body, 408, "The body came too slowly"),
        (json_body, 413, "The body is too large"),
        (json_body, 415, "The body has another content type"),
        (writes, 507, "The server's disk is full"),
        (has_query || id == "jobs_events", 400, "A parameter cannot be used: the answer names it"),
        (is_tus, 412, "`Tus-Resumable` is missing or names another version"),
        (id == "uploads_append" || is_any_tus, 423, "A newer request works on this upload"),
        (is_tus, 503, "Another request works on this upload, or begins one, and does not end"),
        (is_any_tus, 400, "A header is missing or wrong, or the body ended early"),
        (is_any_tus, 404, "No such upload"),
        (is_any_tus, 408, "The bytes came too slowly"),
        (is_any_tus, 409, "The offset is not that of the upload"),
        (is_any_tus, 413, "More bytes than the upload's length"),
        (is_any_tus, 415, "Not application/offset+octet-stream"),
        (is_any_tus, 460, "The checksum is another"),
    ];
    for (applies, status, description) in general {
        if applies {
            let responses = &mut operation.responses.responses;
            responses.entry(status.to_string()).or_insert_with(|| RefOr::T(problem(description)));
        }
    }
    for (status, response) in &mut operation.responses.responses {
        let RefOr::T(response) = response else { continue };
        let header = match status.as_str() {
            "429" | "503" => ("retry-after", "Seconds after which to ask again"),
            "401" => ("www-authenticate", "`Bearer`"),
            _ => continue,
        };
        let kind = if header.0 == "retry-after" { Type::Integer } else { Type::String };
        let described = HeaderBuilder::new().schema(Some(ObjectBuilder::new().schema_type(kind).build()));
        let described = described.description(Some(header.1)).build();
        response.headers.entry(header.0.into()).or_insert(RefOr::T(described));
    }
}

fn problem(description: &str) -> Response {
    let schema = Ref::from_schema_name("Problem");
    let content = ContentBuilder::new().schema(Some(schema)).build();
    ResponseBuilder::new().description(description).content("application/problem+json", content).build()
}
