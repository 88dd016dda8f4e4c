//! The packets of real sensors, sent over UDP on the loopback interface, against the reader of captures.

use crate::common::scans_of;
use std::net::{SocketAddr, UdpSocket};
use std::path::Path;
use std::time::Duration;
use voxelastic::Cloud;
use voxelastic_io::ouster::{Capture, SensorMetadata, datagrams};
use voxelastic_live::feed::{Feed, Overload};
use voxelastic_live::ouster::OusterInput;

const CAPTURES: [(&str, &str); 3] = [
    ("OS-1-64_1024x10_fw20.pcap", "OS-1-64_sensor_config_reduced.json"),
    ("OS-1-128_v2.3.0_1024x10_lb_n3.pcap", "OS-1-128_v2.3.0_1024x10.json"),
    ("OS-0-128-U1_v2.3.0_1024x10.pcap", "OS-0-128-U1_v2.3.0_1024x10.json"),
];
/// UDP may lose datagrams where the system is busy.
const TRIES: usize = 8;

/// The scans that come when the datagrams of a capture are sent, and one of the next turn, with which the last one is complete.
fn sent_over_udp(capture: &Path, metadata: &SensorMetadata) -> Vec<(f64, Cloud)> {
    let input = OusterInput::listen(metadata.clone(), &[SocketAddr::from(([127, 0, 0, 1], 0))], None, true).unwrap();
    let address = input.addresses()[0];
    let feed = Feed::start(Box::new(input), Overload::Wait).unwrap();
    let mut packets: Vec<Vec<u8>> = datagrams(capture).unwrap().map(Result::unwrap).collect();
    // The number of the turn is in the first bytes: here in old packets, there in new ones.
    let mut next_turn = packets.iter().find(|packet| packet.len() > 1000).unwrap().clone();
    [2, 10].iter().for_each(|byte| next_turn[*byte] ^= 0x10);
    packets.push(next_turn);
    let sender = std::thread::spawn(move || {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        // Garbage is ignored.
        socket.send_to(&[7; 100], address).unwrap();
        for packet in packets {
            socket.send_to(&packet, address).unwrap();
            std::thread::sleep(Duration::from_millis(2));
        }
    });
    scans_of(&feed, sender)
}

#[test]
fn scans_that_come_over_udp_are_those_of_the_capture() {
    let Some(folder) = voxelastic_testing::data("ouster") else { return };
    for (capture, metadata) in CAPTURES {
        let [capture, metadata] = [capture, metadata].map(|name| folder.join(name));
        let mut reader = Capture::open(&capture, &metadata).unwrap();
        let expected: Vec<_> = std::iter::from_fn(|| reader.next_scan()).map(Result::unwrap).collect();
        let metadata = SensorMetadata::read(&metadata).unwrap();
        let found = (0..TRIES).map(|_| sent_over_udp(&capture, &metadata)).find(|scans| {
            scans.len() == expected.len()
                && scans.iter().zip(&expected).all(|((time, cloud), scan)| Some(*time) == scan.stamp && same(cloud, &scan.cloud))
        });
        assert!(found.is_some(), "{}: no try brought the scans of the capture", capture.display());
    }
}

fn same(a: &Cloud, b: &Cloud) -> bool {
    let bits = |cloud: &Cloud| cloud.points.iter().flatten().map(|c| c.to_bits()).collect::<Vec<u32>>();
    bits(a) == bits(b) && a.intensity == b.intensity && a.time == b.time && (a.width, a.height) == (b.width, b.height)
}
