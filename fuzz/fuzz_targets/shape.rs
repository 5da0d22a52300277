#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| xbus_fuzz::checks::shape(data));
