#![no_main]

use voxelastic_fuzz::{check, check_memory, file};
use voxelastic_io::ouster::Capture;

/// Metadata of the sensor, a zero byte, packets.
fn read(data: &[u8]) {
    let border = data.iter().position(|b| *b == 0).unwrap_or(data.len());
    let (metadata, packets) = (file(&data[..border], "json"), file(data.get(border + 1..).unwrap_or_default(), "pcap"));
    if let Ok(mut capture) = Capture::open(packets, metadata) {
        let _ = capture.model();
        std::iter::from_fn(|| capture.next_scan()).flatten().for_each(|scan| check(&scan.cloud));
    }
    check_memory();
}

libfuzzer_sys::fuzz_target!(|data: &[u8]| read(data));
