#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| effigy::fuzz_entries::poses(bytes));
