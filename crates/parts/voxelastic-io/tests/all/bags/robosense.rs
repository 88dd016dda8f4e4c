//! Packets of RoboSense's sensors, written here after the makers' manuals for a room whose walls are known.

use crate::bags::packets::{Capture, DEGREES_PER_US, START, WALLS, check_room, table};
use crate::common::damage::soak;
use std::time::Duration;
use voxelastic_io::bag::describe;
use voxelastic_io::{OpenOptions, raw};

/// A sensor, as its manual describes it.
#[derive(Clone, Copy)]
pub(crate) struct RoboSense {
    begins: &'static [u8],
    kind: u8,
    lasers: usize,
    cycle_us: f64,
    /// When each laser fires, microseconds.
    fired_us: fn(usize) -> f64,
    unit: f64,
    /// From the axis to the lens, metres.
    lens: f64,
    has_date: bool,
    angles: fn(usize) -> [f64; 2],
}

const OLD: &[u8] = &[0x55, 0xaa, 0x05, 0x0a, 0x5a, 0xa5, 0x50, 0xa0];
const RS_16: RoboSense = RoboSense {
    begins: OLD,
    kind: 1,
    lasers: 16,
    cycle_us: 55.5,
    fired_us: |laser| 2.8 * laser as f64,
    unit: 0.005,
    lens: 0.03825,
    has_date: true,
    angles: usual_16,
};
pub(crate) const RS_32: RoboSense = RoboSense {
    kind: 2,
    lasers: 32,
    cycle_us: 55.52,
    fired_us: |laser| {
        const US: [f64; 16] = [0.0, 2.88, 5.76, 8.64, 11.52, 14.4, 17.28, 20.16, 23.04, 25.92, 28.8, 31.68, 34.56, 37.44, 40.32, 44.64];
        if laser < 16 { US[laser] } else { US[laser - 16] + 1.44 }
    },
    lens: 0.03997,
    angles: piece_32,
    ..RS_16
};
const HELIOS: RoboSense = RoboSense {
    begins: &[0x55, 0xaa, 0x05, 0x5a],
    kind: 6,
    cycle_us: 55.56,
    fired_us: |laser| 1.73 * laser as f64,
    unit: 0.0025,
    lens: 0.03498,
    has_date: false,
    ..RS_32
};

/// Eight from 15 degrees below the horizon upwards, and eight from 15 above it downwards.
fn usual_16(laser: usize) -> [f64; 2] {
    const DEGREES: [f64; 16] = [-15.0, -13.0, -11.0, -9.0, -7.0, -5.0, -3.0, -1.0, 15.0, 13.0, 11.0, 9.0, 7.0, 5.0, 3.0, 1.0];
    [DEGREES[laser], 0.0]
}

/// Those of a piece.
fn piece_16(laser: usize) -> [f64; 2] {
    [usual_16(laser)[0] + 0.0313 * (laser % 5) as f64 - 0.05, 0.0]
}

/// Those of a piece: in no order, and in hundredths of a degree.
fn piece_32(laser: usize) -> [f64; 2] {
    [((laser * 7 % 32) as f64 * 125.0 - 2500.0) / 100.0, [-8.01, 8.02, -2.67, 2.66][laser % 4]]
}

/// Distance to the walls from a point along a direction.
fn to_wall(from: [f64; 3], direction: [f64; 3]) -> f64 {
    let along = |k: usize| (WALLS[k][usize::from(direction[k] > 0.0)] - from[k]) / direction[k];
    (0..3).filter(|k| direction[*k].abs() > 1e-9).map(along).fold(f64::INFINITY, f64::min)
}

impl RoboSense {
    /// A packet whose first firing is at `us` after the start; of two returns, the first is that of the room and the second is behind it.
    fn packet(&self, us: f64, is_dual: bool) -> Vec<u8> {
        let mut bytes = self.begins.to_vec();
        bytes.resize(20, 0);
        let micros = (START * 1e6 + us).round() as u64;
        if self.has_date {
            // 2023-11-14, 22:25:00 and what has passed since.
            bytes.extend([23, 11, 14, 22, 25, (micros / 1_000_000 % 60) as u8]);
            bytes.extend([(micros / 1000 % 1000) as u16, (micros % 1000) as u16].map(u16::to_be_bytes).concat());
        } else {
            bytes.extend(&(micros / 1_000_000).to_be_bytes()[2..]);
            bytes.extend(((micros % 1_000_000) as u32).to_be_bytes());
        }
        bytes.push(self.kind);
        bytes.resize(42, 0);
        for block in 0..12 {
            // Two returns of 32 lasers take two blocks, those of 16 the halves of one.
            let firings = if is_dual { 1 } else { 32 / self.lasers };
            let group = if is_dual && self.lasers == 32 { block / 2 } else { block };
            let begin = us + self.cycle_us * (group * firings) as f64;
            bytes.extend([0xff, 0xee]);
            bytes.extend((((begin * DEGREES_PER_US * 100.0).round() as u64 % 36_000) as u16).to_be_bytes());
            for k in 0..32 {
                let (laser, half) = (k % self.lasers, k / self.lasers);
                let is_second = is_dual && if self.lasers == 32 { block % 2 == 1 } else { half == 1 };
                let fired = begin + if is_dual { 0.0 } else { self.cycle_us * half as f64 } + (self.fired_us)(laser);
                let [elevation, azimuth] = (self.angles)(laser).map(f64::to_radians);
                let head = (fired * DEGREES_PER_US).to_radians();
                let (angle, lens) = (head + azimuth, [self.lens * head.cos(), -self.lens * head.sin(), 0.0]);
                let direction = [elevation.cos() * angle.cos(), -elevation.cos() * angle.sin(), elevation.sin()];
                let distance = (to_wall(lens, direction) / self.unit).round() as u16 + if is_second { 500 } else { 0 };
                bytes.extend(distance.to_be_bytes());
                bytes.push(laser as u8);
            }
        }
        bytes.resize(1248, 0);
        bytes
    }

    /// A packet about the device.
    fn device(&self, is_dual: bool) -> Vec<u8> {
        let mut bytes = vec![0xa5, 0xff, 0x00, 0x5a, 0x11, 0x11, 0x55, 0x55, 2, 88];
        bytes.resize(300, 0);
        bytes.push(if is_dual { 0 } else { 1 });
        if self.lasers == 16 {
            bytes.resize(1165, 0);
            (0..16).for_each(|laser| bytes.extend(&(((self.angles)(laser)[0].abs() * 1e4).round() as u32).to_be_bytes()[1..]));
        } else {
            bytes.resize(468, 0);
            for which in 0..2 {
                for laser in 0..32 {
                    let hundredths = ((self.angles)(laser)[which] * 100.0).round() as i16;
                    bytes.push(u8::from(hundredths < 0));
                    bytes.extend(hundredths.unsigned_abs().to_be_bytes());
                }
            }
        }
        bytes.resize(1248, 0);
        bytes
    }

    /// A capture of the room, of so many turns, with packets about the device or without.
    pub(crate) fn room(&self, turns: f64, is_dual: bool, has_device: bool) -> Capture {
        let firings = 12 * 32 / self.lasers / if is_dual { 2 } else { 1 };
        let packet_us = self.cycle_us * firings as f64;
        let mut capture = Capture::default();
        for k in 0..(turns * 1e5 / packet_us) as usize {
            let us = k as f64 * packet_us;
            if has_device && k % 300 == 20 {
                capture.add(START + us * 1e-6, 7788, self.device(is_dual));
            }
            capture.add(START + us * 1e-6, 6699, self.packet(us, is_dual));
        }
        capture
    }
}

#[test]
fn walls_of_a_room_are_where_they_are() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(format!("{name}.pcap"));
    check_room(&RS_16.room(3.0, false, false), &path("rs-16-usual"), 3, 28_830, 0.006);
    let piece = RoboSense { angles: piece_16, ..RS_16 };
    for (name, sensor, per_turn) in [("rs-16", piece, 28_830), ("rs-32", RS_32, 57_640), ("helios", HELIOS, 57_600)] {
        for is_dual in [false, true] {
            check_room(&sensor.room(3.0, is_dual, true), &path(&format!("{name}-{is_dual}")), 3, per_turn, 0.006);
        }
    }
}

#[test]
fn angles_of_a_piece_come_from_its_packets_or_from_a_table() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.pcap");
    let notes = |capture: &Capture| {
        std::fs::write(&path, capture.bytes()).unwrap();
        describe(&path, &OpenOptions::default()).map(|d| d.notes.join("; ")).map_err(|e| e.to_string())
    };
    let said = notes(&RS_32.room(0.3, false, true)).unwrap();
    assert!(said.contains("RoboSense RS-LiDAR-32, at 192.168.1.201, port 6699") && said.contains("port 7788"), "{said}");
    let said = notes(&RS_16.room(0.3, false, false)).unwrap();
    assert!(said.contains("RS-LiDAR-16") && said.contains("those of its kind"), "{said}");
    for (name, sensor) in [("RS-LiDAR-32", RS_32), ("RS-Helios", HELIOS)] {
        let said = notes(&sensor.room(0.3, false, false)).unwrap_err();
        assert!(said.contains(name) && said.contains("7788") && said.contains("--metadata"), "{said}");
        let csv = path.with_extension("csv");
        std::fs::write(&csv, table(32, piece_32)).unwrap();
        check_room(&sensor.room(2.0, false, false), &path, 2, 57_620, 0.006);
        std::fs::remove_file(csv).unwrap();
    }
    // Angles that were never set are none.
    let mut unset = RS_32.room(0.3, false, true);
    unset.0.iter_mut().filter(|datagram| datagram.2 == 7788).for_each(|datagram| datagram.3[468..660].fill(0xff));
    assert!(notes(&unset).unwrap_err().contains("7788"));
}

#[test]
fn other_sensors_of_the_make_are_named_and_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.pcap");
    for (sensor, name) in [(RoboSense { kind: 7, ..HELIOS }, "RoboSense Helios-16P or 1615"), (RoboSense { kind: 3, ..RS_32 }, "RoboSense RS-Bpearl")]
    {
        std::fs::write(&path, sensor.room(0.1, false, true).bytes()).unwrap();
        let said = raw::open(&path, &OpenOptions::default()).unwrap_err().to_string();
        assert!(said.contains(name) && said.contains("RS-LiDAR-32"), "{said}");
    }
}

#[test]
fn damaged_packets_never_panic() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.pcap");
    for (name, capture) in [("rs-16", RS_16.room(0.05, false, true)), ("helios", HELIOS.room(0.05, true, true))] {
        soak(name, &capture.bytes(), 200, Duration::from_secs(5), |bad| {
            std::fs::write(&path, bad).unwrap();
            let Ok(scans) = raw::open(&path, &OpenOptions::default()) else { return false };
            let read: Vec<_> = scans.iter().flatten().collect();
            assert!(read.iter().all(|scan| Some(scan.cloud.len()) == scan.cloud.ring.as_ref().map(Vec::len)));
            !read.is_empty()
        });
    }
}
