//! The packets of sensors that turn, sent over UDP on the loopback interface, against the reader of captures.

use crate::common::scans_of;
use std::net::{SocketAddr, UdpSocket};
use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use voxelastic::Cloud;
use voxelastic_io::{OpenOptions, raw};
use voxelastic_live::feed::{Feed, Overload};
use voxelastic_live::spinning::SpinningInput;
use voxelastic_testing::packets::{self, Measured};

/// UDP may lose datagrams where the system is busy.
const TRIES: usize = 8;
/// Turns that are sent: the last one stays unfinished.
const TURNS: f64 = 3.6;
const LOOPBACK: [u8; 4] = [127, 0, 0, 1];

/// A number that looks random.
fn hash(k: usize) -> usize {
    (k.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 23) ^ (k << 3)
}

/// What the k-th beam has measured: anything, or nothing.
fn measured(k: usize) -> Measured {
    let distance = if hash(k).is_multiple_of(7) { 0 } else { 1000 + hash(k + 1) % 20_000 };
    (distance as f64 * 0.002, hash(k + 2) as u8)
}

/// A capture file of the packets, as they come from this machine.
fn pcap(packets: &[(f64, Vec<u8>)]) -> Vec<u8> {
    let mut bytes = [0xa1b2_c3d4u32.to_le_bytes(), [2, 0, 4, 0], [0; 4], [0; 4], [0, 0, 1, 0], 1u32.to_le_bytes()].concat();
    for (time, payload) in packets {
        let (udp, port) = (payload.len() as u16 + 8, 2368u16.to_be_bytes());
        let mut frame = [vec![0; 12], vec![8, 0, 0x45, 0], (udp + 20).to_be_bytes().to_vec(), vec![0, 0, 0, 0, 64, 17, 0, 0]].concat();
        frame.extend([LOOPBACK, LOOPBACK, [port[0], port[1], port[0], port[1]]].concat());
        frame.extend([udp.to_be_bytes(), [0, 0]].concat());
        frame.extend(payload);
        let micros = (time.fract() * 1e6).min(999_999.0) as u32;
        bytes.extend([*time as u32, micros, frame.len() as u32, frame.len() as u32].iter().flat_map(|n| n.to_le_bytes()));
        bytes.extend(frame);
    }
    bytes
}

/// The scans that come when the packets are sent, with garbage among them.
fn sent_over_udp(packets: &[(f64, Vec<u8>)], from: Option<[u8; 4]>) -> Vec<(f64, Cloud)> {
    let input = SpinningInput::listen(SocketAddr::from((LOOPBACK, 0)), from.map(Into::into), None).unwrap();
    let address = input.address();
    let feed = Feed::start(Box::new(input), Overload::Wait).unwrap();
    let packets: Vec<Vec<u8>> = packets.iter().map(|(_, payload)| payload.clone()).collect();
    let sender = std::thread::spawn(move || {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        socket.send_to(&[7; 100], address).unwrap();
        for (k, packet) in packets.into_iter().enumerate() {
            socket.send_to(&packet, address).unwrap();
            if k % 50 == 10 {
                // Position packets, and what is no packet, or half of one.
                socket.send_to(&[9; 512], address).unwrap();
                socket.send_to(&packet[..packet.len() / 2], address).unwrap();
                socket.send_to(&[], address).unwrap();
            }
            std::thread::sleep(Duration::from_micros(400));
        }
    });
    scans_of(&feed, sender)
}

/// What is measured in time is compared to a microsecond: the clock of a sensor that is not set is that of the receiver.
fn same(a: &Cloud, b: &Cloud) -> bool {
    let bits = |cloud: &Cloud| cloud.points.iter().flatten().map(|c| c.to_bits()).collect::<Vec<u32>>();
    let times = |cloud: &Cloud| cloud.time.clone().unwrap();
    let differ = |(a, b): (f32, f32)| (a - b).abs() > 1e-6;
    bits(a) == bits(b) && a.intensity == b.intensity && a.ring == b.ring && !times(a).into_iter().zip(times(b)).any(differ)
}

fn read(path: &Path) -> Vec<raw::TimedScan> {
    raw::open(path, &OpenOptions::default()).unwrap().iter().map(Result::unwrap).collect()
}

#[test]
fn scans_that_come_over_udp_are_those_of_the_capture() {
    let dir = tempfile::tempdir().unwrap();
    let makes: [(&str, fn(f64) -> Vec<(f64, Vec<u8>)>); 2] = [
        ("velodyne", |start| packets::velodyne(start, TURNS, |beam| measured(beam.number))),
        ("hesai", |start| packets::hesai(start, TURNS, |beam| measured(beam.number))),
    ];
    for (name, packets) in makes {
        let path = dir.path().join(format!("{name}.pcap"));
        let attempt = |_| {
            // The hour of a Velodyne's clock is told by when its packets come.
            let start = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs_f64().floor();
            let packets = packets(start);
            std::fs::write(&path, pcap(&packets)).unwrap();
            let (expected, scans) = (read(&path), sent_over_udp(&packets, Some(LOOPBACK)));
            let is_same = |(found, expected): (&(f64, Cloud), &raw::TimedScan)| {
                let is_set = name == "velodyne";
                same(&found.1, &expected.cloud) && (!is_set || (found.0 - expected.time).abs() < 1e-5)
            };
            // The unfinished turn is in the file, as the file has ended.
            expected.len() == 4 && scans.len() == 3 && expected[0].cloud.len() > 15_000 && scans.iter().zip(&expected).all(is_same)
        };
        assert!((0..TRIES).any(attempt), "{name}: no try brought the scans of the capture");
        assert!(sent_over_udp(&packets(0.0), Some([127, 0, 0, 9])).is_empty(), "{name}: another machine's packets are ignored");
    }
}
