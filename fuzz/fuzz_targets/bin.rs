#![no_main]

use voxelastic_io::CloudFormat;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    voxelastic_fuzz::read_cloud(data, CloudFormat::KittiBin);
    voxelastic_fuzz::read_cloud(data, CloudFormat::XyzBin);
});
