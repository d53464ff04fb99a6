//! The fuzzer's way into the parsers of requests ([`crate::fuzz_entries`]).

use std::sync::{Mutex, OnceLock, PoisonError};

use axum::body::Body;
use axum::extract::Request;
use axum::http::{HeaderMap, HeaderName, HeaderValue, header};

use super::app::Limits;
use super::pace::Lateness;
use super::{jobs, uploads};
use crate::storage::Store;

/// The body of `POST /v1/jobs` as `multipart/form-data` with the boundary `b`. Nothing of a refused one stays.
pub fn form(bytes: &[u8]) {
    static STORE: OnceLock<Mutex<(tempfile::TempDir, Store)>> = OnceLock::new();
    let store = STORE.get_or_init(|| {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let store = Store::open(folder.path()).expect("a store");
        Mutex::new((folder, store))
    });
    // What another leaves for a moment is not this one's.
    let (folder, store) = &*store.lock().unwrap_or_else(PoisonError::into_inner);
    let request = Request::builder().header(header::CONTENT_TYPE, "multipart/form-data; boundary=b");
    let request = request.body(Body::from(bytes.to_vec())).expect("a request");
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    runtime.block_on(async {
        let form = jobs::Form::of(request).await.expect("the header is a form's");
        let limits = Limits { upload_bytes: 1 << 20, ..Limits::default() };
        drop(jobs::receive(form, store, &limits, true, &Lateness::default()).await);
    });
    let left = std::fs::read_dir(folder.path().join("tmp")).expect("its folder").count();
    assert_eq!(left, 0, "an upload that nobody took stays");
}

/// Headers of resumable uploads, one a line.
pub fn tus_headers(bytes: &[u8]) {
    let mut headers = HeaderMap::new();
    for line in bytes.split(|&byte| byte == b'\n') {
        let Some(colon) = line.iter().position(|&byte| byte == b':') else { continue };
        let name = HeaderName::from_bytes(&line[..colon]);
        let value = HeaderValue::from_bytes(line[colon + 1..].trim_ascii());
        if let (Ok(name), Ok(value)) = (name, value) {
            headers.append(name, value);
        }
    }
    uploads::read_headers(&headers);
}
