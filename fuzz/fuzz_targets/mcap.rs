#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| voxelastic_fuzz::play(data, "mcap"));
