//! The fuzzer's way into the parser of pickled models ([`crate::fuzz_entries`]).

use super::{pickle, pickled_arrays, smpl};

/// The corpus has further arrays, of all kinds.
const MORE_NAMES: [&str; 5] = ["fortran", "big", "csr", "coo", "far"];

/// Values of a dictionary, far more than a small input can hold.
const MAX_VALUES: usize = 1 << 20;

/// A pickle of SMPL's, up to the body.
pub fn pickle(bytes: &[u8]) {
    let names = [&smpl::NAMES[..], &MORE_NAMES].concat();
    let arrays = pickle::parse(bytes).and_then(|pickle| pickled_arrays::dictionary(&pickle.value, &names, MAX_VALUES));
    if let Ok(arrays) = arrays
        && let Ok(body) = smpl::body(&arrays, "fuzz")
    {
        body.check().expect("an imported body is sound");
    }
}
