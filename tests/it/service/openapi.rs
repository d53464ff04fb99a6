//! The committed description is the handlers' own.

use super::*;

#[test]
fn the_committed_description_is_that_of_the_handlers() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/openapi.yaml");
    let committed = std::fs::read_to_string(path).unwrap();
    assert!(committed == effigy::http::openapi::yaml().unwrap(), "openapi.yaml is stale: run `make openapi`");
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
