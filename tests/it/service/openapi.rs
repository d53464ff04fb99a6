//! The committed description is the handlers' own.

use super::*;

#[test]
fn the_committed_description_is_that_of_the_handlers() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/openapi.yaml");
    let committed = std::fs::read_to_string(path).unwrap();
    assert!(committed == effigy::http::openapi::yaml().unwrap(), "openapi.yaml is stale: run `make openapi`");
}

fn description() -> Value {
    yaml_serde::from_str(&effigy::http::openapi::yaml().unwrap()).unwrap()
}

/// Path, method and description of each operation.
fn operations(api: &Value) -> Vec<(String, String, &Value)> {
    let paths = api["paths"].as_object().unwrap().iter();
    let methods = ["get", "head", "post", "put", "patch", "delete", "options"];
    paths
        .flat_map(|(path, item)| {
            let found =
                methods.iter().filter_map(|method| Some((path.clone(), method.to_string(), item.get(*method)?)));
            found.collect::<Vec<_>>()
        })
        .collect()
}

#[test]
fn every_operation_is_named_described_and_lists_its_errors() {
    let api = description();
    let mut ids = std::collections::BTreeSet::new();
    let operations = operations(&api);
    assert!(operations.len() > 25, "{}", operations.len());
    for (path, method, operation) in operations {
        let at = format!("{method} {path}");
        let id = operation["operationId"].as_str().unwrap_or_else(|| panic!("{at} has no name"));
        assert!(ids.insert(id.to_string()), "{at}: {id} is another's");
        for text in ["summary", "description"] {
            assert!(operation[text].as_str().is_some_and(|text| text.len() > 4), "{at} has no {text}");
        }
        let responses = operation["responses"].as_object().unwrap();
        let mut errors = Vec::new();
        if path.starts_with("/v1/") || path == "/metrics" {
            errors.extend(["401", "403", "429", "500"]);
        }
        if path.contains("{id}") {
            errors.push("404");
        }
        if operation["requestBody"]["content"].get("application/json").is_some() {
            errors.extend(["400", "408", "413", "415"]);
        }
        if path.starts_with("/v1/")
            && ["post", "patch", "delete"].contains(&method.as_str())
            && !path.contains("avatars")
        {
            errors.push("507");
        }
        for status in errors {
            assert!(responses.contains_key(status), "{at} ({id}) does not list {status}");
        }
        for (status, response) in responses {
            assert!(response["description"].as_str().is_some_and(|text| !text.is_empty()), "{at} {status}");
            if matches!(status.as_str(), "429" | "503") {
                assert!(response["headers"].get("retry-after").is_some(), "{at} {status}");
            }
        }
    }
}

#[test]
fn what_is_guarded_tells_how_a_key_is_sent() {
    let api = description();
    let scheme = &api["components"]["securitySchemes"]["bearer"];
    assert_eq!((&scheme["type"], &scheme["scheme"]), (&json!("http"), &json!("bearer")));
    for (path, method, operation) in operations(&api) {
        let is_guarded = path.starts_with("/v1/") || path == "/metrics";
        let asked = is_guarded.then(|| json!([{ "bearer": [] }, {}]));
        assert_eq!(operation.get("security"), asked.as_ref(), "{method} {path}");
    }
}

#[test]
fn every_body_has_an_example_that_is_one() {
    let api = description();
    let mut checked = 0;
    for (path, method, operation) in operations(&api) {
        let bodies = operation["responses"].as_object().unwrap().iter();
        let bodies = bodies.map(|(status, response)| (status.as_str(), response));
        for (status, body) in bodies.chain(operation.get("requestBody").map(|body| ("request", body))) {
            for (kind, content) in body["content"].as_object().into_iter().flatten() {
                let at = format!("{method} {path}, {status}, {kind}");
                let example = content.get("example").unwrap_or_else(|| panic!("{at} has no example"));
                if kind.ends_with("json") {
                    check(&api, &content["schema"], example, &at);
                    checked += 1;
                }
                if kind == "application/problem+json" {
                    assert_eq!(example["status"].to_string(), status, "{at}");
                }
            }
        }
    }
    assert!(checked > 60, "{checked} examples");
}

#[test]
fn bodies_are_text_or_json_or_bytes() {
    let api = description();
    let binary = json!({ "type": "string", "format": "binary" });
    let mut bytes = Vec::new();
    for (path, method, operation) in operations(&api) {
        let responses = operation["responses"].as_object().unwrap();
        for body in responses.values().chain([&operation["requestBody"]]) {
            for (kind, content) in body["content"].as_object().into_iter().flatten() {
                let is_text = kind.starts_with("text/") || kind.ends_with("json") || kind == "application/yaml";
                if is_text || kind == "multipart/form-data" {
                    continue;
                }
                assert_eq!(content["schema"], binary, "{method} {path} {kind}");
                bytes.push(kind.as_str());
            }
        }
    }
    for kind in ["application/octet-stream", "application/offset+octet-stream", "image/png", "image/jpeg"] {
        assert!(bytes.contains(&kind), "{bytes:?}");
    }
}

/// The first is what generated clients speak.
#[test]
fn a_clip_is_first_of_all_a_form() {
    let api: yaml_serde::Value = yaml_serde::from_str(&effigy::http::openapi::yaml().unwrap()).unwrap();
    let content = api["paths"]["/v1/jobs"]["post"]["requestBody"]["content"].as_mapping().unwrap();
    let kinds: Vec<_> = content.keys().map(|kind| kind.as_str().unwrap()).collect();
    assert_eq!(kinds, ["multipart/form-data", "application/json"]);
}

/// What a schema of ours can say: references, objects with their fields, arrays, types.
fn check(api: &Value, schema: &Value, value: &Value, at: &str) {
    if let Some(reference) = schema["$ref"].as_str() {
        let name = reference.rsplit('/').next().unwrap();
        return check(api, &api["components"]["schemas"][name], value, at);
    }
    if let Some(one_of) = schema["oneOf"].as_array() {
        let fits = |schema: &&Value| !(value.is_null() ^ (schema["type"] == "null"));
        return check(api, one_of.iter().find(fits).unwrap(), value, at);
    }
    for part in schema["allOf"].as_array().into_iter().flatten() {
        check(api, part, value, at);
    }
    let types = match &schema["type"] {
        Value::Array(types) => types.clone(),
        Value::Null => Vec::new(),
        one => vec![one.clone()],
    };
    let actual = match value {
        Value::Null => "null",
        Value::Bool(_) => "boolean",
        Value::Number(number) if number.is_f64() => "number",
        Value::Number(_) => "integer",
        Value::String(_) => "string",
        Value::Array(_) => "array",
        Value::Object(_) => "object",
    };
    let fits = types.is_empty() || types.iter().any(|t| t == actual || (t == "number" && actual == "integer"));
    assert!(fits, "{at}: {value} is no {types:?}");
    if let Some(words) = schema["enum"].as_array() {
        assert!(words.contains(value), "{at}: {value} is none of {words:?}");
    }
    for (n, item) in value.as_array().into_iter().flatten().enumerate() {
        check(api, &schema["items"], item, &format!("{at}[{n}]"));
    }
    let (Some(fields), Some(known)) = (value.as_object(), schema["properties"].as_object()) else { return };
    for name in schema["required"].as_array().into_iter().flatten() {
        assert!(fields.contains_key(name.as_str().unwrap()), "{at} lacks {name}");
    }
    for (name, field) in fields {
        // Two halves of an `allOf` each know their own.
        match known.get(name) {
            Some(schema) => check(api, schema, field, &format!("{at}.{name}")),
            None => assert!(at.contains("camera"), "{at} has no {name}"),
        }
    }
}

#[tokio::test]
async fn each_kind_of_file_is_described() {
    let bench = Bench::new().await;
    let names = ["a.glb", "a.vrm", "a.png", "a.json", "a.html", "a.mp4", "a.npz", "a.ply"];
    let avatar = bench.publish(&names.map(|name| (name, &b"some bytes"[..]))).await;
    let api = description();
    let responses = &api["paths"]["/v1/avatars/{id}/{file}"]["get"]["responses"];
    for name in names {
        for (status, headers) in [("200", &[][..]), ("206", &[("range", "bytes=1-2")])] {
            let reply = bench.call(Method::GET, &format!("/v1/avatars/{avatar}/{name}"), headers, Body::empty()).await;
            assert_eq!(reply.status.as_str(), status);
            let kind = reply.header("content-type").split(';').next().unwrap();
            assert!(responses[status]["content"].get(kind).is_some(), "{name}, {status}: {kind}");
        }
    }
}

#[tokio::test]
async fn the_server_tells_its_description() {
    let bench = Bench::new().await;
    let reply = bench.get("/openapi.yaml").await;
    assert_eq!(reply.header("content-type"), "application/yaml");
    let text = String::from_utf8(reply.body).unwrap();
    for path in ["/v1/jobs", "/v1/jobs/{id}", "/v1/jobs/{id}/events", "/v1/avatars/{id}/renders", "/readyz"] {
        assert!(text.contains(&format!("\n  {path}:\n")), "{path}");
    }
}

/// What lies at a bound of a schema, and one beyond it, by field.
fn at_the_bounds(schema: &Value) -> Vec<(String, Value, Value)> {
    let mut found = Vec::new();
    for (name, field) in schema["properties"].as_object().unwrap() {
        for (bound, beyond) in [("minimum", -1), ("maximum", 1)] {
            let bound = &field[bound];
            match bound.as_i64() {
                // serde's own: a whole number that is not negative.
                Some(0) if field["format"] != "double" => {}
                Some(whole) => found.push((name.clone(), json!(whole), json!(whole + beyond))),
                None if bound.is_number() => {
                    found.push((name.clone(), bound.clone(), json!(bound.as_f64().unwrap() + 0.01 * beyond as f64)));
                }
                None => {}
            }
        }
    }
    found
}

#[tokio::test]
async fn bounds_are_those_that_are_checked() {
    let api = description();
    let schemas = &api["components"]["schemas"];
    let options = at_the_bounds(&schemas["JobOptions"]);
    assert!(options.len() >= 10, "{options:?}");
    for (name, bound, beyond) in options {
        let parsed = |value: &Value| JobOptions::parse(json!({ &name: value }).to_string().as_bytes());
        assert!(parsed(&bound).is_ok(), "{name}: {bound}");
        let error = parsed(&beyond).unwrap_err();
        assert_eq!(error.field.as_deref(), Some(name.as_str()), "{beyond}");
    }

    let bench = Bench::new().await;
    let avatar = format!("/v1/avatars/{}", bench.publish(&[("avatar.glb", b"glb")]).await);
    for (name, bound, beyond) in at_the_bounds(&schemas["CameraBody"]) {
        let body = |value: &Value| {
            let mut camera = json!({ "width": 10, "height": 10, "fx": 9, "fy": 9, "cx": 5, "cy": 5 });
            camera[&name] = value.clone();
            // Another mistake, which is looked for after the camera.
            json!({ "frame": 0, "camera": camera, "background": "none" })
        };
        for (value, part) in [(bound, "background".into()), (beyond, format!("camera.{name}"))] {
            let problem = bench.post_json(&format!("{avatar}/renders"), &body(&value)).await.problem(422);
            assert_eq!(problem["part"], part, "{value}");
        }
    }
    for (name, bound, beyond) in at_the_bounds(&schemas["LinksBody"]) {
        for (value, fits) in [(bound, true), (beyond, false)] {
            let answer =
                bench.post_json(&format!("{avatar}/links"), &json!({ "files": ["avatar.glb"], &name: value })).await;
            assert_eq!(answer.status.is_success(), fits, "{name} {value}: {}", answer.status);
        }
    }
    let limit =
        &api["paths"]["/v1/jobs"]["get"]["parameters"].as_array().unwrap().iter().find(|p| p["name"] == "limit");
    let limit = &limit.unwrap()["schema"];
    for (bound, beyond) in [("minimum", -1), ("maximum", 1)] {
        let bound = limit[bound].as_i64().unwrap();
        for (value, status) in [(bound, 200), (bound + beyond, 400)] {
            let answer = bench.get(&format!("/v1/jobs?limit={value}")).await;
            assert_eq!(answer.status, status, "limit {value}");
        }
    }
}
