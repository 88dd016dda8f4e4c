#![no_main]

use voxelastic_fuzz::{check, check_memory, file};
use voxelastic_io::{OpenOptions, raw};

/// A table of angles, a zero byte, a capture of the packets of any sensor.
fn read(data: &[u8]) {
    let border = data.iter().position(|b| *b == 0).unwrap_or(data.len());
    let (angles, packets) = (file(&data[..border], "csv"), file(data.get(border + 1..).unwrap_or_default(), "pcap"));
    let with_angles = OpenOptions { metadata: (border > 0).then_some(angles), ..OpenOptions::default() };
    for options in [OpenOptions::default(), with_angles] {
        if let Ok(scans) = raw::open(&packets, &options) {
            scans.iter().flatten().for_each(|scan| check(&scan.cloud));
        }
    }
    check_memory();
}

libfuzzer_sys::fuzz_target!(|data: &[u8]| read(data));
