#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| effigy::parsers::tus_headers(bytes));
