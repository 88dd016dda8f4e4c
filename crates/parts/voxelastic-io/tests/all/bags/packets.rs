//! Packets of Velodyne's and Hesai's sensors, written here for a room whose walls are known, and held against decoders by others: `velodyne-decoder` and
//! `hydra4` (`VOXELASTIC_PYTHON`, default `python3`).

use crate::common::damage::soak;
use std::path::Path;
use std::time::Duration;
use voxelastic::event::{Event, Scan};
use voxelastic_io::bag::{Recording, describe};
use voxelastic_io::dataset::Keyframing;
use voxelastic_io::raw;
use voxelastic_io::{Error, OpenOptions};
use voxelastic_testing::run_python;

/// When the first packet is captured, seconds: 25 minutes past the hour.
pub(crate) const START: f64 = 1_700_000_700.0;
/// A turn takes a tenth of a second.
pub(crate) const DEGREES_PER_US: f64 = 3600.0 / 1e6;
const SENSOR: [u8; 4] = [192, 168, 1, 201];
/// Walls of the room around the sensor, metres.
pub(crate) const WALLS: [[f64; 2]; 3] = [[-8.0, 12.0], [-6.0, 9.0], [-1.5, 4.0]];

/// Distance to the walls from a point of the sensor's axis along a direction.
fn to_wall(height: f64, direction: [f64; 3]) -> f64 {
    let from = [0.0, 0.0, height];
    let along = |k: usize| (WALLS[k][usize::from(direction[k] > 0.0)] - from[k]) / direction[k];
    (0..3).filter(|k| direction[*k].abs() > 1e-9).map(along).fold(f64::INFINITY, f64::min)
}

/// Distance from a point to the nearest wall.
fn off_wall(p: [f32; 3]) -> f64 {
    (0..3).flat_map(|k| WALLS[k].map(|wall| (f64::from(p[k]) - wall).abs())).fold(f64::INFINITY, f64::min)
}

/// A capture with datagrams from a sensor, each with its time.
#[derive(Default)]
pub(crate) struct Capture(pub(crate) Vec<(f64, [u8; 4], u16, Vec<u8>)>);

impl Capture {
    pub(crate) fn add(&mut self, time: f64, port: u16, payload: Vec<u8>) {
        self.0.push((time, SENSOR, port, payload));
    }

    pub(crate) fn bytes(&self) -> Vec<u8> {
        let mut bytes = [0xa1b2_c3d4u32.to_le_bytes(), [2, 0, 4, 0], [0; 4], [0; 4], [0, 0, 1, 0], 1u32.to_le_bytes()].concat();
        for (time, source, port, payload) in &self.0 {
            let udp = payload.len() as u16 + 8;
            let mut frame = vec![0; 12];
            frame.extend([8, 0, 0x45, 0]);
            frame.extend((udp + 20).to_be_bytes());
            frame.extend([0, 0, 0, 0, 64, 17, 0, 0]);
            frame.extend(source);
            frame.extend([255, 255, 255, 255]);
            frame.extend([port.to_be_bytes(), port.to_be_bytes(), udp.to_be_bytes(), [0, 0]].concat());
            frame.extend(payload);
            let micros = ((time - time.floor()) * 1e6).round().min(999_999.0) as u32;
            let head = [time.floor() as u32, micros, frame.len() as u32, frame.len() as u32];
            bytes.extend(head.iter().flat_map(|n| n.to_le_bytes()));
            bytes.extend(frame);
        }
        bytes
    }
}

/// A Velodyne sensor, as its manual describes it.
pub(crate) struct Velodyne {
    product: u8,
    lasers: usize,
    cycle_us: f64,
    fired_us: fn(usize) -> f64,
    /// Elevation and azimuth, degrees.
    angles: fn(usize) -> [f64; 2],
    /// From the axis to the point through which all beams pass, metres.
    origin: f64,
    unit: f64,
}

pub(crate) const VLP_16: Velodyne = Velodyne {
    product: 0x22,
    lasers: 16,
    cycle_us: 55.296,
    fired_us: |laser| 2.304 * laser as f64,
    angles: |laser| [if laser % 2 == 0 { laser as f64 - 15.0 } else { laser as f64 }, 0.0],
    origin: 0.04191,
    unit: 0.002,
};
const HDL_32: Velodyne = Velodyne {
    product: 0x21,
    lasers: 32,
    cycle_us: 46.08,
    fired_us: |laser| 1.152 * laser as f64,
    angles: |laser| [if laser % 2 == 0 { -92.0 / 3.0 } else { -28.0 / 3.0 } + (laser / 2) as f64 * 4.0 / 3.0, 0.0],
    origin: 0.02895,
    unit: 0.002,
};
/// Only its packets: the angles are known to the oracle.
const VLP_32C: Velodyne =
    Velodyne { product: 0x28, fired_us: |laser| 2.304 * (laser / 2) as f64, cycle_us: 55.296, unit: 0.004, angles: |_| [0.0; 2], ..HDL_32 };
const HI_RES: Velodyne = Velodyne { product: 0x24, ..VLP_16 };

/// A number that looks random.
fn hash(k: usize) -> usize {
    (k.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 23) ^ (k << 3)
}

impl Velodyne {
    /// A packet whose first firing is at `us` after the start of the recording. `measure` gives the distance in units and the intensity of the k-th return,
    /// at a direction of the head in degrees, by a laser; of a pair of blocks, `false` is the last and `true` the strongest return.
    fn packet(&self, us: f64, is_dual: bool, measure: &mut dyn FnMut(f64, usize, bool) -> (u16, u8)) -> Vec<u8> {
        let cycles = 32 / self.lasers;
        let block_us = self.cycle_us * cycles as f64;
        let mut bytes = Vec::new();
        for block in 0..12 {
            let (at, is_strongest) = if is_dual { (block / 2, block % 2 == 1) } else { (block, true) };
            let begin = us + block_us * at as f64;
            bytes.extend([0xff, 0xee]);
            bytes.extend((((begin * DEGREES_PER_US * 100.0).round() as u64 % 36_000) as u16).to_le_bytes());
            for cycle in 0..cycles {
                for laser in 0..self.lasers {
                    let fired = begin + self.cycle_us * cycle as f64 + (self.fired_us)(laser);
                    let (distance, intensity) = measure(fired * DEGREES_PER_US, laser, is_strongest);
                    bytes.extend(distance.to_le_bytes());
                    bytes.push(intensity);
                }
            }
        }
        let past_hour = (START % 3600.0 * 1e6 + us).round() as u32;
        bytes.extend(past_hour.to_le_bytes());
        bytes.extend([if is_dual { 0x39 } else { 0x37 }, self.product]);
        bytes
    }

    /// A capture of the room, of so many turns.
    pub(crate) fn room(&self, turns: f64, is_dual: bool) -> Capture {
        let packet_us = self.cycle_us * (32 / self.lasers * if is_dual { 6 } else { 12 }) as f64;
        let mut capture = Capture::default();
        for k in 0..(turns * 1e5 / packet_us) as usize {
            let us = k as f64 * packet_us;
            let mut measure = |head: f64, laser: usize, is_strongest: bool| {
                let [elevation, azimuth] = (self.angles)(laser);
                let (angle, elevation) = ((head + azimuth).to_radians(), elevation.to_radians());
                let direction = [elevation.cos() * angle.cos(), -elevation.cos() * angle.sin(), elevation.sin()];
                // Last returns, which are not used, are behind the walls.
                ((to_wall(-self.origin * elevation.tan(), direction) / self.unit).round() as u16 + if is_strongest { 0 } else { 500 }, laser as u8)
            };
            capture.add(START + us * 1e-6, 2368, self.packet(us, is_dual, &mut measure));
            if k % 100 == 50 {
                // Position packets go to a port of their own.
                capture.add(START + us * 1e-6, 8308, vec![7; 512]);
            }
        }
        capture
    }
}

/// A Hesai sensor with a head of twelve bytes, or without one.
pub(crate) struct Hesai {
    channels: usize,
    blocks: usize,
    has_head: bool,
}

pub(crate) const XT_32: Hesai = Hesai { channels: 32, blocks: 8, has_head: true };
const XT_16: Hesai = Hesai { channels: 16, ..XT_32 };
pub(crate) const PANDAR_40P: Hesai = Hesai { channels: 40, blocks: 10, has_head: false };

impl Hesai {
    /// A packet whose last block is fired at `us`. `measure` gives distance and intensity by the direction of the head, degrees, the channel, and whether it is
    /// the strongest return.
    fn packet(&self, us: f64, mode: u8, measure: &mut dyn FnMut(f64, usize, bool) -> (u16, u8)) -> Vec<u8> {
        let is_dual = mode == 0x39;
        let block_us = if self.has_head { 50.0 } else { 55.56 };
        let groups = if is_dual { self.blocks / 2 } else { self.blocks };
        let mut bytes = if self.has_head { vec![0xee, 0xff, 6, 1, 0, 0, self.channels as u8, self.blocks as u8, 0, 4, 1, 1] } else { Vec::new() };
        for block in 0..self.blocks {
            let (group, is_strongest) = if is_dual { (block / 2, block % 2 == 1) } else { (block, true) };
            let begin = us - block_us * (groups - 1 - group) as f64;
            let hundredths = (begin * DEGREES_PER_US * 100.0).round().rem_euclid(36_000.0) as u16;
            if !self.has_head {
                bytes.extend([0xff, 0xee]);
            }
            bytes.extend(hundredths.to_le_bytes());
            for channel in 0..self.channels {
                let (distance, intensity) = measure(f64::from(hundredths) * 0.01, channel, is_strongest);
                bytes.extend(distance.to_le_bytes());
                bytes.push(intensity);
                bytes.extend(self.has_head.then_some(0));
            }
        }
        // 2023-11-14, 22:25:00 and what has passed since.
        let (seconds, micros) = ((us * 1e-6).floor(), (us.rem_euclid(1e6)) as u32);
        let date = [14, 22, 25, seconds as u8];
        if self.has_head {
            bytes.extend([&[0; 10][..], &[mode, 0, 0, 123, 11], &date, &micros.to_le_bytes(), &[0x42, 0, 0, 0, 0]].concat());
        } else {
            bytes.extend([&[0; 10][..], &micros.to_le_bytes(), &[mode, 0x42, 23, 11], &date, &[9; 4]].concat());
        }
        bytes
    }

    pub(crate) fn room(&self, turns: f64, mode: u8, angles: fn(usize) -> [f64; 2]) -> Capture {
        let packet_us = if self.has_head { 50.0 } else { 55.56 } * (self.blocks / if mode == 0x39 { 2 } else { 1 }) as f64;
        let mut capture = Capture::default();
        for k in 1..(turns * 1e5 / packet_us) as usize {
            let us = k as f64 * packet_us;
            let mut measure = |head: f64, channel: usize, is_strongest: bool| {
                let [elevation, azimuth] = angles(channel).map(f64::to_radians);
                let angle = head.to_radians() + azimuth;
                let direction = [elevation.cos() * angle.sin(), elevation.cos() * angle.cos(), elevation.sin()];
                ((to_wall(0.0, direction) / 0.004).round() as u16 + if is_strongest { 0 } else { 500 }, channel as u8)
            };
            capture.add(START + us * 1e-6, 2368, self.packet(us, mode, &mut measure));
        }
        capture
    }
}

/// The angles of a Pandar40P as its manual has them: a third of a degree apart from 2 degrees above the horizon to 6 below, rounded to hundredths.
pub(crate) fn pandar40p(channel: usize) -> [f64; 2] {
    const OUTER: [f64; 15] = [15.0, 11.0, 8.0, 5.0, 3.0, -7.0, -8.0, -9.0, -10.0, -11.0, -12.0, -13.0, -14.0, -19.0, -25.0];
    let hundredths = |degrees: f64| (degrees * 100.0).round() / 100.0;
    match channel {
        0..5 => [OUTER[channel], -1.042],
        5 => [2.0, -1.042],
        6..30 => [hundredths((11.0 - channel as f64) / 3.0), [3.125, -5.208, -1.042][(channel - 6) % 3]],
        _ => [OUTER[channel - 25], -1.042],
    }
}

/// The angles of a piece, in the order of its channels.
pub(crate) fn tilted(channel: usize) -> [f64; 2] {
    [15.0 - channel as f64 * 0.97, 0.3 * ((channel % 3) as f64 - 1.0)]
}

pub(crate) fn table(channels: usize, angles: fn(usize) -> [f64; 2]) -> String {
    let line = |channel| format!("{},{:.3},{:.3}\n", channel + 1, angles(channel)[0], angles(channel)[1]);
    format!("Channel,Elevation,Azimuth\n{}", (0..channels).map(line).collect::<String>())
}

pub(crate) fn scans(path: &Path, options: &OpenOptions) -> Vec<raw::TimedScan> {
    raw::open(path, options).unwrap_or_else(|e| panic!("{e}")).iter().map(|scan| scan.unwrap()).collect()
}

/// Writes a capture and reads its scans again; checks that all points are on the walls, and that turns are whole, each in its time.
pub(crate) fn check_room(capture: &Capture, path: &Path, turns: usize, per_turn: usize, off: f64) {
    std::fs::write(path, capture.bytes()).unwrap();
    check_scans(path, START, turns, per_turn, off);
}

/// Checks that all points of a recording are on the walls, and that turns are whole, each in its time from a start on.
pub(crate) fn check_scans(path: &Path, start: f64, turns: usize, per_turn: usize, off: f64) {
    let scans = scans(path, &OpenOptions::default());
    let name = path.display();
    assert!(scans.len() == turns || scans.len() == turns + 1, "{name}: {} scans", scans.len());
    for (k, scan) in scans.iter().enumerate().take(turns) {
        let worst = scan.cloud.points.iter().map(|p| off_wall(*p)).fold(0.0, f64::max);
        assert!(worst < off, "{name}, scan {k}: {worst} m off the walls");
        let count = scan.cloud.len();
        assert!(count.abs_diff(per_turn) <= per_turn / 50, "{name}, scan {k}: {count} points");
        assert!((scan.time - start - 0.1 * k as f64).abs() < 2e-3, "{name}, scan {k}: {}", scan.time - start);
        let times = scan.cloud.time.as_ref().unwrap();
        let last = times.iter().copied().fold(0.0, f32::max);
        assert!((0.098..0.101).contains(&last), "{name}: a turn takes {last} s");
    }
}

#[test]
fn walls_of_a_room_are_where_they_are() {
    let dir = tempfile::tempdir().unwrap();
    // Angles are rounded to hundredths of a degree, by up to 15 m away.
    let velodyne = [("vlp-16", VLP_16, 28_900), ("hdl-32e", HDL_32, 69_400)];
    for (name, sensor, per_turn) in velodyne {
        check_room(&sensor.room(3.0, false), &dir.path().join(format!("{name}.pcap")), 3, per_turn, 0.006);
        check_room(&sensor.room(3.0, true), &dir.path().join(format!("{name}-dual.pcap")), 3, per_turn, 0.006);
    }
    let even: fn(usize) -> [f64; 2] = |channel| [15.0 - channel as f64, 0.0];
    let even_16: fn(usize) -> [f64; 2] = |channel| [15.0 - 2.0 * channel as f64, 0.0];
    let sensors = [("xt-32", XT_32, 64_000, even), ("xt-16", XT_16, 32_000, even_16), ("pandar40p", PANDAR_40P, 72_000, pandar40p)];
    for (name, sensor, per_turn, angles) in sensors {
        for mode in [0x37, 0x39] {
            check_room(&sensor.room(3.0, mode, angles), &dir.path().join(format!("{name}-{mode:x}.pcap")), 3, per_turn, 0.004);
        }
    }
}

#[test]
fn angles_of_the_piece_are_read_from_its_table() {
    let dir = tempfile::tempdir().unwrap();
    for (name, sensor, per_turn) in [("xt-32", XT_32, 64_000), ("pandar40p", PANDAR_40P, 72_000)] {
        let path = dir.path().join(format!("{name}.pcap"));
        let capture = sensor.room(2.0, 0x37, tilted);
        std::fs::write(&path, capture.bytes()).unwrap();
        let d = describe(&path, &OpenOptions::default()).unwrap();
        assert!(d.notes.iter().any(|note| note.contains("--metadata")), "{:?}", d.notes);
        let csv = path.with_extension("csv");
        std::fs::write(&csv, table(sensor.channels, tilted)).unwrap();
        check_room(&capture, &path, 2, per_turn, 0.004);
        let d = describe(&path, &OpenOptions::default()).unwrap();
        assert!(d.notes.iter().any(|note| note.contains(".csv")), "{:?}", d.notes);
        std::fs::remove_file(csv).unwrap();
    }
    // A table of another sensor is refused, and so is what is none.
    let (path, wrong) = (dir.path().join("xt-32.pcap"), dir.path().join("wrong"));
    let open = |text: &str| {
        std::fs::write(&wrong, text).unwrap();
        raw::open(&path, &OpenOptions { metadata: Some(wrong.clone()), ..OpenOptions::default() }).unwrap_err().to_string()
    };
    assert!(open(&table(16, tilted)).contains("angles of 16 channels, but a PandarXT-32 has 32"));
    assert!(open("a,b\n1,2\n").contains("no columns of elevation"));
    assert!(open("Channel,Elevation,Azimuth\n1,95,0\n").contains("beyond the zenith"));
    assert!(open("Channel,Elevation,Azimuth\n1,x,0\n").contains("not two angles"));
}

/// The points of `velodyne-decoder`: x, y, z, intensity, ring, whether it is the strongest return.
const VELODYNE_ORACLE: &str = "
import sys, numpy as np, velodyne_decoder as vd
clouds = [np.asarray(points) for _, points in vd.read_pcap(sys.argv[1], vd.Config(min_range=0.01, max_range=1000))]
p = np.concatenate(clouds)
f = vd.PointField
columns = [f.x, f.y, f.z, f.intensity, f.ring, f.return_type]
p[:, columns].astype('<f8').tofile(sys.argv[2])
";

#[test]
fn velodynes_points_are_those_of_another_decoder() {
    let dir = tempfile::tempdir().unwrap();
    let (path, out) = (dir.path().join("a.pcap"), dir.path().join("points"));
    for (name, sensor) in [("VLP-16", VLP_16), ("Puck Hi-Res", HI_RES), ("VLP-32C", VLP_32C), ("HDL-32E", HDL_32)] {
        for is_dual in [false, true] {
            let packet_us = sensor.cycle_us * (32 / sensor.lasers * if is_dual { 6 } else { 12 }) as f64;
            let mut capture = Capture::default();
            let mut k = 0;
            for packet in 0..(3.5e5 / packet_us) as usize {
                let us = packet as f64 * packet_us;
                let mut measure = |_: f64, _: usize, is_strongest: bool| {
                    k += 1;
                    // In each firing, distances are those of no other laser nearby, and some lasers see nothing.
                    let distance = if hash(k).is_multiple_of(11) { 0 } else { 2000 + (hash(k) % 40_000) as u16 };
                    (distance, if is_strongest { (hash(k) % 100) as u8 } else { 100 + (hash(k) % 100) as u8 })
                };
                capture.add(START + us * 1e-6, 2368, sensor.packet(us, is_dual, &mut measure));
            }
            std::fs::write(&path, capture.bytes()).unwrap();
            if run_python("velodyne_decoder, numpy", VELODYNE_ORACLE, &[&path, &out]).is_none() {
                return;
            }
            let bytes = std::fs::read(&out).unwrap();
            let theirs: Vec<f64> = bytes.as_chunks().0.iter().map(|b| f64::from_le_bytes(*b)).collect();
            let mut known: std::collections::HashMap<(i64, i64, i64), Vec<[f64; 3]>> = std::collections::HashMap::new();
            let key = |p: [f64; 3], intensity: f64, ring: f64| {
                let range = p.iter().map(|v| v * v).sum::<f64>().sqrt();
                ((range / sensor.unit).round() as i64, intensity as i64, ring as i64)
            };
            let mut count = 0;
            for p in theirs.chunks_exact(6).filter(|p| p[3] < 100.0) {
                let xyz = [p[0], p[1], p[2]];
                known.entry(key(xyz, p[3], p[4])).or_default().push(xyz);
                count += 1;
            }
            let d = describe(&path, &OpenOptions::default()).unwrap();
            assert!(d.notes[0].contains(&format!("Velodyne {name}, at 192.168.1.201, port 2368")), "{:?}", d.notes);
            let (mut worst, mut seen, mut all) = (0.0f64, 0, 0);
            for scan in scans(&path, &OpenOptions::default()) {
                let (intensity, ring) = (scan.cloud.intensity.unwrap(), scan.cloud.ring.unwrap());
                for (k, p) in scan.cloud.points.iter().enumerate() {
                    let p = p.map(f64::from);
                    let range = p.iter().map(|v| v * v).sum::<f64>().sqrt();
                    let apart = |q: &[f64; 3]| (0..3).map(|k| (p[k] - q[k]).powi(2)).sum::<f64>().sqrt() / range;
                    let (units, intensity, ring) = key(p, f64::from(intensity[k]), f64::from(ring[k]));
                    let candidates = (units - 1..=units + 1).filter_map(|units| known.get(&(units, intensity, ring)));
                    let nearest = candidates.flatten().map(apart).fold(f64::INFINITY, f64::min);
                    all += 1;
                    if nearest < 0.01 {
                        seen += 1;
                        worst = worst.max(nearest);
                    }
                }
            }
            eprintln!(
                "{name}, {}: {seen} of {all} points, {count} of theirs; at most {:.2} mrad apart",
                if is_dual { "dual" } else { "single" },
                worst * 1e3
            );
            assert!(all > 50_000 && seen as f64 > 0.995 * f64::from(all), "{name}: {seen} of {all}");
            assert!(worst < 5e-4, "{name}: {worst} rad");
        }
    }
}

/// The points of `hydra4`, packet by packet: x, y, z, intensity, channel.
const HESAI_ORACLE: &str = "
import sys, numpy as np
from pathlib import Path
from types import SimpleNamespace
from hydra4.decoders import PandarXT32
data = Path(sys.argv[1]).read_bytes()
decoder = PandarXT32(Path(sys.argv[3]), 0.01, 1000.0)
out, at = [], 24
while at < len(data):
    size = int.from_bytes(data[at + 8 : at + 12], 'little')
    packet = SimpleNamespace(data=data[at + 16 + 42 : at + 16 + size])
    at += 16 + size
    for block in decoder(packet):
        out += [p[:5] for p in block.points]
np.array(out, '<f8').tofile(sys.argv[2])
";

#[test]
fn hesais_points_are_those_of_another_decoder() {
    let dir = tempfile::tempdir().unwrap();
    let (path, out, csv) = (dir.path().join("a.pcap"), dir.path().join("points"), dir.path().join("a.csv"));
    std::fs::write(&path, XT_32.room(1.5, 0x37, tilted).bytes()).unwrap();
    std::fs::write(&csv, table(32, tilted)).unwrap();
    if run_python("hydra4, numpy", HESAI_ORACLE, &[&path, &out, &csv]).is_none() {
        return;
    }
    let bytes = std::fs::read(&out).unwrap();
    let theirs: Vec<f64> = bytes.as_chunks().0.iter().map(|b| f64::from_le_bytes(*b)).collect();
    let ours: Vec<[f64; 5]> = scans(&path, &OpenOptions::default())
        .into_iter()
        .flat_map(|scan| {
            let (points, intensity, ring) = (scan.cloud.points, scan.cloud.intensity.unwrap(), scan.cloud.ring.unwrap());
            (0..points.len())
                .map(|k| [points[k][0].into(), points[k][1].into(), points[k][2].into(), intensity[k].into(), ring[k].into()])
                .collect::<Vec<_>>()
        })
        .collect();
    assert!(ours.len() > 60_000 && theirs.len() >= 5 * ours.len());
    let worst = ours.iter().zip(theirs.chunks_exact(5)).flat_map(|(a, b)| (0..5).map(move |k| (a[k] - b[k]).abs())).fold(0.0, f64::max);
    eprintln!("{} points, {worst:.1e} m apart at most", ours.len());
    assert!(worst < 1e-4, "{worst} m");
}

#[test]
fn what_is_lost_mixed_or_of_another_kind_is_said_and_left_out() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.pcap");
    let mut capture = VLP_16.room(3.0, false);
    // Another sensor at the same port, one of another make, packets that are cut, and a gap.
    let mut other = HDL_32.room(0.3, false);
    other.0.iter_mut().for_each(|datagram| datagram.1 = [192, 168, 1, 202]);
    let count = capture.0.len();
    capture.0.drain(count / 2..count / 2 + 20);
    capture.0[30].3.truncate(700);
    capture.0[31].3[0] = 0;
    capture.0[32].3[2..4].copy_from_slice(&40_000u16.to_le_bytes());
    capture.0.splice(40..40, other.0.into_iter().chain(XT_32.room(0.1, 0x37, tilted).0));
    std::fs::write(&path, capture.bytes()).unwrap();
    let d = describe(&path, &OpenOptions::default()).unwrap();
    let said = d.to_string();
    assert!(said.contains("sensor: Velodyne VLP-16, at 192.168.1.201"), "{said}");
    assert!(said.contains("not read: Velodyne HDL-32E, at 192.168.1.202") && said.contains("not read: Hesai PandarXT-32"), "{said}");
    let scans = scans(&path, &OpenOptions::default());
    assert!(scans.iter().flat_map(|scan| &scan.cloud.points).all(|p| off_wall(*p) < 0.006), "no point of another sensor");
    assert!((2..=4).contains(&scans.len()), "{}", scans.len());

    // Sensors that are not read are named.
    let open = |capture: &Capture| {
        std::fs::write(&path, capture.bytes()).unwrap();
        raw::open(&path, &OpenOptions::default()).unwrap_err().to_string()
    };
    for (product, name) in [(0xa1, "Velodyne VLS-128"), (0x99, "Velodyne product 0x99")] {
        let said = open(&Velodyne { product, ..VLP_16 }.room(0.1, false));
        assert!(said.contains(name) && said.contains("VLP-32C"), "{said}");
    }
    let mut older = VLP_16.room(0.1, false);
    older.0.iter_mut().filter(|d| d.3.len() == 1206).for_each(|d| (1..12).step_by(2).for_each(|block| d.3[100 * block + 1] = 0xdd));
    assert!(open(&older).contains("Velodyne HDL-64E"));
    // And what is nobody's.
    let mut nothing = Capture::default();
    nothing.add(START, 2368, vec![1; 1206]);
    assert!(open(&nothing).contains("no packets of a sensor that is known"), "{}", open(&nothing));
}

#[test]
fn a_capture_and_a_trajectory_are_a_map() {
    let dir = tempfile::tempdir().unwrap();
    let (path, poses) = (dir.path().join("a.pcap"), dir.path().join("poses.tum"));
    std::fs::write(&path, VLP_16.room(3.0, false).bytes()).unwrap();
    let lines: String = (0..40).map(|k| format!("{:.3} 0 0 2 0 0 0 1\n", START - 0.01 + 0.01 * f64::from(k))).collect();
    std::fs::write(&poses, lines).unwrap();
    let options = OpenOptions { poses: Some(poses), keyframing: Some(Keyframing::All), ..OpenOptions::default() };
    let recording = Recording::open(&path, &options).unwrap();
    let scans: Vec<Scan> = recording.events().filter_map(|e| if let Event::Scan(scan) = e.unwrap() { Some(scan) } else { None }).collect();
    assert!(scans.len() >= 2 && scans.iter().all(|scan| scan.t_map_lidar.translation.z == 2.0 && scan.cloud.motion.is_some()));
    assert!(matches!(Recording::open(&path, &OpenOptions::default()), Err(Error::NoPoses { .. })), "they are estimated then");
}

#[test]
fn damaged_packets_never_panic() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.pcap");
    let captures =
        [("velodyne", VLP_16.room(0.03, true)), ("hesai", XT_32.room(0.02, 0x37, tilted)), ("pandar40p", PANDAR_40P.room(0.02, 0x39, tilted))];
    for (name, capture) in captures {
        soak(name, &capture.bytes(), 200, Duration::from_secs(5), |bad| {
            std::fs::write(&path, bad).unwrap();
            let Ok(scans) = raw::open(&path, &OpenOptions::default()) else { return false };
            let read: Vec<_> = scans.iter().flatten().collect();
            assert!(read.iter().all(|scan| Some(scan.cloud.len()) == scan.cloud.ring.as_ref().map(Vec::len)));
            !read.is_empty()
        });
    }
}
