//! The fuzzer's ways into every parser that meets bytes of strangers, by name. The targets of `fuzz/` and the test over
//! the committed corpora (`tests/it/fuzz.rs`) run the same functions: whatever the bytes are, none may panic, hang or take
//! memory that the bytes do not account for, and what a parser accepts is sound.

use std::io::Cursor;

use crate::body::Body;
use crate::jobs::JobOptions;
use crate::npz::Npz;

pub use crate::body::import::fuzz_entries::pickle;
pub use crate::capture::fuzz_entries::{camera, keypoints, masks, poses};
pub use crate::http::fuzz_entries::{form, tus_headers};

/// Takes whatever comes, and returns.
pub type Entry = fn(&[u8]);

/// With the name of the parser, which is also that of its corpus in `fuzz/corpus/`.
pub const ENTRIES: [(&str, Entry); 10] = [
    ("options", options),
    ("form", form),
    ("tus_headers", tus_headers),
    ("keypoints", keypoints),
    ("camera", camera),
    ("poses", poses),
    ("masks", masks),
    ("npz", npz),
    ("body", body),
    ("pickle", pickle),
];

/// Values of an archive, far more than a small input can hold.
const MAX_VALUES: usize = 1 << 20;

/// The `options` of a job. What is accepted can be said again.
pub fn options(bytes: &[u8]) {
    if let Ok(options) = JobOptions::parse(bytes) {
        let text = serde_json::to_vec(&options).expect("options are JSON");
        assert_eq!(JobOptions::parse(&text).ok(), Some(options), "accepted options are accepted again");
    }
}

/// An archive of arrays.
pub fn npz(bytes: &[u8]) {
    if let Ok(npz) = Npz::read(Cursor::new(bytes), MAX_VALUES) {
        for (name, array) in &npz.arrays {
            assert_eq!(array.shape.iter().product::<usize>(), array.data.len(), "{name}");
        }
    }
}

/// A body file. What is accepted is a sound body.
pub fn body(bytes: &[u8]) {
    if let Ok(body) = Body::read(Cursor::new(bytes)) {
        body.check().expect("a body that was read is sound");
    }
}
