//! The fuzzer's way into the parser of pickled models ([`crate::fuzz_entries`]).

use super::{pickle, pickled_arrays, smpl};

/// A pickle of SMPL's, up to the body.
pub fn pickle(bytes: &[u8]) {
    let arrays = pickle::parse(bytes).and_then(|pickle| pickled_arrays::dictionary(&pickle.value));
    if let Ok(arrays) = arrays
        && let Ok(body) = smpl::body(&arrays, "fuzz")
    {
        body.check().expect("an imported body is sound");
    }
}
