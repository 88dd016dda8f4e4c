//! Ouster captures against `ouster-sdk`. The captures are real (`VOXELASTIC_DATA`); the oracle needs a Python with the package
//! (`VOXELASTIC_PYTHON`, default `python3`).

use crate::common::damage::soak;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;
use voxelastic::Cloud;
use voxelastic::event::{Event, Scan};
use voxelastic::mapper::Mapper;
use voxelastic::sensor::{BeamModel, detect};
use voxelastic::settings::Settings;
use voxelastic_io::bag::Recording;
use voxelastic_io::dataset::Keyframing;
use voxelastic_io::ouster::{Capture, find_metadata};
use voxelastic_io::{OpenOptions, StampedCloud, poses};

const CAPTURES: [(&str, &str, usize, usize); 3] = [
    ("OS-1-64_1024x10_fw20.pcap", "OS-1-64_sensor_config_reduced.json", 64, 1),
    ("OS-1-128_v2.3.0_1024x10_lb_n3.pcap", "OS-1-128_v2.3.0_1024x10.json", 128, 3),
    ("OS-0-128-U1_v2.3.0_1024x10.pcap", "OS-0-128-U1_v2.3.0_1024x10.json", 128, 1),
];

/// Range and xyz of every pixel of every frame, staggered, as f64; then the time of every column, nanoseconds.
const ORACLE: &str = r#"
import sys, numpy as np
from ouster.sdk import open_source, core
capture, meta, out = sys.argv[1:4]
source = open_source(capture, meta=[meta])
info = source.sensor_info[0]
lut = core.XYZLut(info, False)
with open(out, "wb") as file:
    for frames in source:
        for frame in frames:
            r = frame.field("RANGE")
            xyz = lut(frame)
            file.write(r.astype("<f8").tobytes()); file.write(xyz.astype("<f8").tobytes())
            file.write(frame.timestamp.astype("<u8").tobytes())
"#;

fn folder() -> Option<PathBuf> {
    voxelastic_testing::data("ouster")
}

fn scans(capture: &Path, metadata: &Path) -> Vec<StampedCloud> {
    let mut capture = Capture::open(capture, metadata).unwrap();
    std::iter::from_fn(|| capture.next_scan()).map(Result::unwrap).collect()
}

#[test]
fn captures_are_found_with_their_metadata_and_hold_whole_turns() {
    let Some(folder) = folder() else { return };
    for (capture, metadata, rows, count) in CAPTURES {
        let capture = folder.join(capture);
        assert_eq!(find_metadata(&capture).unwrap(), folder.join(metadata));
        let scans = scans(&capture, &folder.join(metadata));
        assert_eq!(scans.len(), count, "{}", capture.display());
        for StampedCloud { cloud, stamp, .. } in &scans {
            assert!(cloud.height == rows && cloud.width == 1024 && cloud.is_organised() && stamp.unwrap() > 0.0);
            let last = cloud.time.as_ref().unwrap().iter().copied().fold(0.0, f32::max);
            assert!((0.099..0.101).contains(&last), "a turn takes {last} s");
        }
    }
}

#[test]
fn the_beams_are_the_sensors_own() {
    let Some(folder) = folder() else { return };
    for (capture, metadata, ..) in CAPTURES {
        let (capture, metadata) = (folder.join(capture), folder.join(metadata));
        let model = Capture::open(&capture, &metadata).unwrap().model().unwrap();
        let cloud = &scans(&capture, &metadata)[0].cloud;
        let (mut worst, mut seen) = (0.0f32, 0);
        for (i, p) in cloud.points.iter().enumerate().filter(|(_, p)| Cloud::is_return(p)) {
            let Some(at) = model.project(*p) else { panic!("{p:?} is seen by no row") };
            let (row, column) = (i / cloud.width, i % cloud.width);
            let aside = (at.column - column as f32 + 1536.0).rem_euclid(1024.0) - 512.0;
            // Near returns and rows that stand close together leave room for doubt about the row.
            if at.range > 2.0 && (at.row - row as f32).abs() < 0.5 {
                worst = worst.max(aside.abs());
                seen += 1;
            }
        }
        eprintln!("{}: {seen} returns in their pixels, at most {worst} columns aside", capture.display());
        assert!(worst < 1.01 && seen > 10_000, "{worst} columns");
    }
}

/// Angle between what two models say of a pixel, radians: mean and largest.
fn apart(a: &BeamModel, b: &BeamModel) -> (f64, f64) {
    let angle = |(row, column): (usize, usize)| {
        let (p, q) = (a.direction(row as f32, column as f32), b.direction(row as f32, column as f32));
        (0..3).map(|k| f64::from(p[k] - q[k]).powi(2)).sum::<f64>().sqrt()
    };
    let pixels = || (0..a.rows()).flat_map(|row| (0..a.columns()).map(move |column| (row, column)));
    (pixels().map(angle).sum::<f64>() / a.pixels() as f64, pixels().map(angle).fold(0.0, f64::max))
}

#[test]
fn a_mapper_takes_the_sensors_own_tables() {
    let Some(folder) = folder() else { return };
    for (capture, metadata, ..) in CAPTURES {
        let (capture, metadata) = (folder.join(capture), folder.join(metadata));
        let scans = scans(&capture, &metadata);
        let exact = Capture::open(&capture, &metadata).unwrap().model().unwrap();
        let found = detect(&[&scans[0].cloud]).unwrap().model;
        let elevations = exact.elevations();
        let even = BeamModel::even(exact.rows(), exact.columns(), elevations[0], elevations[exact.rows() - 1]).unwrap();
        let uneven = (0..exact.rows()).map(|r| (even.elevation(r as f32) - elevations[r]).abs()).fold(0.0, f32::max);
        let (mean, worst) = apart(&exact, &found);
        eprintln!(
            "{}: beams found from one scan are {:.2} mrad off in the mean, {:.1} at most; rows evenly spaced {:.1} mrad at most",
            capture.display(),
            1e3 * mean,
            1e3 * worst,
            1e3 * uneven
        );
        let mut mapper = Mapper::new(Settings { voxel_size: 0.2, ..Settings::default() }).unwrap();
        mapper.set_sensor_model(exact.clone());
        let scan = Scan { node: 0, time: 0.0, t_map_lidar: voxelastic::Pose::identity(), cloud: scans[0].cloud.clone() };
        let report = mapper.handle(Event::Scan(scan)).unwrap().unwrap();
        assert!(mapper.sensor().unwrap().contains("the sensor's own tables"), "{:?}", mapper.sensor());
        assert_eq!(report.counts.outside, 0, "the points are where the tables say");
    }
}

/// A Python with `ouster-sdk`; none, with a word, where there is no such.
fn sdk() -> Option<String> {
    voxelastic_testing::python("ouster.sdk, numpy")
}

/// Holds ranges, points and times of a capture of `count` turns against the sdk's.
fn hold_against_the_sdk(interpreter: &str, capture: &Path, metadata: &Path, count: usize) {
    let dir = tempfile::tempdir().unwrap();
    let out = dir.path().join("frames");
    let said = Command::new(interpreter).args(["-c", ORACLE]).args([capture, metadata, &out]).output().unwrap();
    assert!(said.status.success(), "{}", String::from_utf8_lossy(&said.stderr));
    let bytes = std::fs::read(&out).unwrap();
    let scans = scans(capture, metadata);
    let rows = scans[0].cloud.height;
    let (columns, pixels) = (1024, rows * 1024);
    let frame = pixels * 8 * 4 + columns * 8;
    assert_eq!((bytes.len(), scans.len()), (frame * count, count));
    let (mut worst, mut returns) = (0.0f64, 0);
    for (scan, bytes) in scans.iter().zip(bytes.chunks_exact(frame)) {
        let number = |k: usize| f64::from_le_bytes(bytes[8 * k..8 * k + 8].try_into().unwrap());
        let time = |c: usize| u64::from_le_bytes(bytes[8 * (4 * pixels + c)..][..8].try_into().unwrap());
        let first = (0..columns).map(time).filter(|t| *t > 0).min().unwrap();
        assert!((scan.stamp.unwrap() - first as f64 * 1e-9).abs() < 1e-6);
        // Each row is the sdk's turned by a whole number of columns.
        for row in 0..rows {
            let same = |shift: usize| {
                (0..columns).all(|c| (number(row * columns + c) > 0.0) == Cloud::is_return(&scan.cloud.points[row * columns + (c + shift) % columns]))
            };
            let fits = |shift: &usize| {
                same(*shift)
                    && (0..columns).filter(|c| number(row * columns + c) > 0.0).all(|c| {
                        let p = scan.cloud.points[row * columns + (c + shift) % columns];
                        (0..3).all(|k| (f64::from(p[k]) - number(pixels + 3 * (row * columns + c) + k)).abs() < 1e-3)
                    })
            };
            let shift = (0..columns).find(fits).unwrap_or_else(|| panic!("{}: row {row} is another", capture.display()));
            for c in (0..columns).filter(|c| number(row * columns + c) > 0.0) {
                let i = row * columns + (c + shift) % columns;
                let p = scan.cloud.points[i];
                let off = (0..3).map(|k| (f64::from(p[k]) - number(pixels + 3 * (row * columns + c) + k)).abs()).fold(0.0, f64::max);
                worst = worst.max(off);
                returns += 1;
                let t = scan.cloud.time.as_ref().unwrap()[i];
                assert!((f64::from(t) - (time(c) - first) as f64 * 1e-9).abs() < 1e-6);
            }
        }
    }
    eprintln!("{}: {returns} returns, at most {:.4} mm from the sdk's", capture.display(), 1e3 * worst);
    assert!(returns > 15_000);
}

#[test]
fn ranges_points_and_times_are_those_of_the_sdk() {
    let (Some(folder), Some(interpreter)) = (folder(), sdk()) else { return };
    for (capture, metadata, _, count) in CAPTURES {
        hold_against_the_sdk(&interpreter, &folder.join(capture), &folder.join(metadata), count);
    }
}

/// Packs a turn of a real capture anew, in the ways of packing that the captures are not in: a capture and its metadata for each.
const REPACK: &str = r#"
import json, sys
from ouster.sdk import core, open_source, pcap
capture, meta, folder = sys.argv[1:4]
source = open_source(capture, meta=[meta])
frame = next(iter(source))[0]
for profile in ("RNG19_RFL8_SIG16_NIR16", "RNG19_RFL8_SIG16_NIR16_DUAL"):
    described = json.loads(source.sensor_info[0].to_json_string())
    for section in ("config_params", "lidar_data_format"):
        described[section]["udp_profile_lidar"] = profile
    info = core.SensorInfo(json.dumps(described))
    again = core.LidarFrame(info)
    again.frame_id = frame.frame_id
    again.timestamp[:], again.status[:], again.measurement_id[:] = frame.timestamp, frame.status, frame.measurement_id
    for name, shift in (("RANGE", 0), ("REFLECTIVITY", 0), ("RANGE2", 4000), ("REFLECTIVITY2", 0)):
        if again.has_field(name):
            field = frame.field(name.strip("2"))
            again.field(name)[:] = field + (field > 0).astype(field.dtype) * shift
    packets = core.frame_to_packets(again, core.PacketFormat.from_info(info), info.init_id, int(info.sn))
    pcap.record(packets, f"{folder}/{profile}.pcap")
    with open(f"{folder}/{profile}.json", "w") as file:
        file.write(json.dumps(described))
"#;

#[test]
fn other_ways_of_packing_are_read_as_the_sdk_reads_them() {
    let (Some(folder), Some(interpreter)) = (folder(), sdk()) else { return };
    let dir = tempfile::tempdir().unwrap();
    let (capture, metadata, ..) = CAPTURES[2];
    let said =
        Command::new(&interpreter).args(["-c", REPACK]).args([&folder.join(capture), &folder.join(metadata)]).arg(dir.path()).output().unwrap();
    assert!(said.status.success(), "{}", String::from_utf8_lossy(&said.stderr));
    let original = &scans(&folder.join(capture), &folder.join(metadata))[0];
    for profile in ["RNG19_RFL8_SIG16_NIR16", "RNG19_RFL8_SIG16_NIR16_DUAL"] {
        let at = |ending: &str| dir.path().join(format!("{profile}.{ending}"));
        hold_against_the_sdk(&interpreter, &at("pcap"), &at("json"), 1);
        let again = &scans(&at("pcap"), &at("json"))[0];
        // Bits, because a pixel without return is NaN.
        let bits = |scan: &StampedCloud| scan.cloud.points.iter().flatten().map(|v| v.to_bits()).collect::<Vec<u32>>();
        assert!(bits(again) == bits(original) && again.cloud.intensity == original.cloud.intensity, "{profile}");
    }
}

#[test]
fn a_capture_and_a_trajectory_are_a_recording() {
    let Some(folder) = folder() else { return };
    let (capture, metadata, ..) = CAPTURES[1];
    let capture = folder.join(capture);
    let stamps: Vec<f64> = scans(&capture, &folder.join(metadata)).iter().map(|s| s.stamp.unwrap()).collect();
    let dir = tempfile::tempdir().unwrap();
    let trajectory = dir.path().join("slam.tum");
    let begin = stamps[0] - 0.05;
    let ride: Vec<(f64, voxelastic::Pose)> =
        (0..10).map(|k| (begin + 0.05 * f64::from(k), voxelastic::Pose::translation(0.1 * f64::from(k), 0.0, 0.0))).collect();
    poses::write_tum(&trajectory, &ride).unwrap();
    let none = Recording::open(&capture, &OpenOptions::default()).unwrap_err();
    assert!(none.to_string().contains("--poses"), "{none}");
    let options = OpenOptions { poses: Some(trajectory), keyframing: Some(Keyframing::All), ..OpenOptions::default() };
    let recording = Recording::open(&capture, &options).unwrap();
    let taken: Vec<_> = recording.events().filter_map(|e| if let Ok(Event::Scan(s)) = e { Some(s) } else { None }).collect();
    assert_eq!(taken.len(), 3);
    assert_eq!(recording.sensor().map(|model| (model.rows(), model.columns())), Some((128, 1024)));
    // 2 m/s: the first column of the first scan is taken where its pose is, the last 0.2 m on.
    let motion = taken[0].cloud.motion.as_ref().unwrap();
    assert!((motion.at(0.1).translation.x - 0.2).abs() < 0.01, "{motion:?}");
}

#[test]
fn damaged_captures_never_panic() {
    let Some(folder) = folder() else { return };
    let dir = tempfile::tempdir().unwrap();
    let (capture, metadata) = (dir.path().join("a.pcap"), dir.path().join("a.json"));
    let (packets, json) = (std::fs::read(folder.join(CAPTURES[2].0)).unwrap(), std::fs::read(folder.join(CAPTURES[2].1)).unwrap());
    // A few packets will do.
    let packets = &packets[..40_000];
    let read = || {
        Capture::open(&capture, &metadata).is_ok_and(|mut c| {
            let _ = c.model();
            std::iter::from_fn(|| c.next_scan()).take(100).count() > 0
        })
    };
    std::fs::write(&metadata, &json).unwrap();
    soak("packets", packets, 100, Duration::from_secs(5), |bad| {
        std::fs::write(&capture, bad).unwrap();
        read()
    });
    std::fs::write(&capture, packets).unwrap();
    soak("metadata", &json, 100, Duration::from_secs(5), |bad| {
        std::fs::write(&metadata, bad).unwrap();
        read()
    });
}
