#![no_main]

libfuzzer_sys::fuzz_target!(|input: &[u8]| spharm_fuzz::run("landmarks", input));
