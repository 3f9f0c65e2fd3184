#![no_main]

#[path = "../src/mod.rs"]
mod readers;

libfuzzer_sys::fuzz_target!(|data: &[u8]| readers::run("archives", readers::scratch(), data));
