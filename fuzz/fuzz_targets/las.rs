#![no_main]

use voxelastic_io::CloudFormat;

// The reader catches the panics of the LAZ decoder; libFuzzer's hook would end the process before.
libfuzzer_sys::fuzz_target!(init: std::panic::set_hook(Box::new(|_| ())), |data: &[u8]| voxelastic_fuzz::read_cloud(data, CloudFormat::Las));
