//! Faults that people make with poses, on recorded data: each is named, and what is right raises no alarm.

use super::*;
use nalgebra::{Quaternion, Translation3, UnitQuaternion, Vector3};
use std::fs;
use std::path::PathBuf;
use voxelastic_io::poses::write_tum;
use voxelastic_io::source::Source as RegisteredSource;

/// A data set: its name, the folder of its clouds, and its poses.
const SETS: [(&str, &str, &str); 3] =
    [("hall", "scans", "poses.tum"), ("kitti00-street", "velodyne", "poses_groundtruth.txt"), ("kitti00-seq", "velodyne", "poses_groundtruth.txt")];

/// What was done to the poses, and a word of the warning that names it; an empty word: nothing may be said.
struct Fault {
    name: &'static str,
    word: &'static str,
    spoil: fn(&[(f64, Pose)]) -> Vec<Pose>,
}

fn each(poses: &[(f64, Pose)], change: impl Fn(&Pose) -> Pose) -> Vec<Pose> {
    poses.iter().map(|(_, pose)| change(pose)).collect()
}

/// The poses of a body, on which the lidar is so turned (roll, pitch, yaw, degrees) and placed.
fn of_body(poses: &[(f64, Pose)], angles: [f64; 3], place: [f64; 3]) -> Vec<Pose> {
    let [roll, pitch, yaw] = angles.map(f64::to_radians);
    let t_body_lidar = Pose::from_parts(Translation3::from(Vector3::from(place)), UnitQuaternion::from_euler_angles(roll, pitch, yaw));
    each(poses, |pose| pose * t_body_lidar.inverse())
}

fn later(poses: &[(f64, Pose)], seconds: f64) -> Vec<Pose> {
    let at = |time: f64| {
        let after = poses.partition_point(|(t, _)| *t < time).clamp(1, poses.len() - 1);
        let ((t0, a), (t1, b)) = (poses[after - 1], poses[after]);
        a.lerp_slerp(&b, ((time - t0) / (t1 - t0)).clamp(0.0, 1.0))
    };
    poses.iter().map(|(time, _)| at(time + seconds)).collect()
}

fn w_first(pose: &Pose) -> Pose {
    let q = pose.rotation.coords;
    Pose::from_parts(pose.translation, UnitQuaternion::from_quaternion(Quaternion::new(q.z, q.w, q.x, q.y)))
}

/// Odometry that drifts by this share of its path, in a direction that wanders.
fn drifting(poses: &[(f64, Pose)], share: f64) -> Vec<Pose> {
    let mut pose = poses[0].1;
    let mut all = vec![pose];
    for (k, pair) in poses.windows(2).enumerate() {
        let step = pair[0].1.inv_mul(&pair[1].1);
        let path = step.translation.vector.norm();
        let angle = (k as f64 * 0.3).sin() * std::f64::consts::PI;
        let off = Vector3::new(angle.cos(), angle.sin(), 0.3) * share * path;
        pose *= Pose::from_parts(
            Translation3::from(step.translation.vector + off),
            step.rotation * UnitQuaternion::from_euler_angles(0.0, 0.0, share * 0.05 * path),
        );
        all.push(pose);
    }
    all
}

fn faults() -> Vec<Fault> {
    vec![
        Fault { name: "right", word: "", spoil: |p| each(p, |pose| *pose) },
        Fault { name: "drift of 2 %", word: "", spoil: |p| drifting(p, 0.02) },
        Fault { name: "w first", word: "w first", spoil: |p| each(p, w_first) },
        Fault { name: "inverse", word: "inverse", spoil: |p| each(p, Pose::inverse) },
        Fault { name: "inverse, w first", word: "w first", spoil: |p| each(p, |pose| w_first(&pose.inverse())) },
        Fault { name: "camera", word: "camera", spoil: |p| of_body(p, [90.0, -90.0, 0.0], [0.0, -0.1, -0.3]) },
        Fault { name: "quarter turn", word: "another frame", spoil: |p| of_body(p, [0.0, 0.0, 90.0], [0.0, 0.0, 0.0]) },
        Fault { name: "half turn, upside down", word: "another frame", spoil: |p| of_body(p, [180.0, 0.0, 0.0], [0.3, 0.0, 0.2]) },
        Fault { name: "free turn", word: "another frame", spoil: |p| of_body(p, [0.0, 15.0, 30.0], [0.8, 0.3, 1.6]) },
        Fault { name: "one row", word: "1 rows", spoil: |p| (0..p.len()).map(|k| p[(k + 1).min(p.len() - 1)].1).collect() },
        Fault { name: "five rows", word: "5 rows", spoil: |p| (0..p.len()).map(|k| p[k.saturating_sub(5)].1).collect() },
        Fault { name: "0.35 s", word: "s later", spoil: |p| later(p, -0.35) },
        Fault { name: "1.7 s", word: "s earlier", spoil: |p| later(p, 1.7) },
        Fault {
            name: "millimetres",
            word: "multiplied by 0.001",
            spoil: |p| each(p, |pose| Pose::from_parts(Translation3::from(pose.translation.vector * 1e3), pose.rotation)),
        },
        Fault { name: "reversed rows", word: "do not fit", spoil: |p| p.iter().rev().map(|(_, pose)| *pose).collect() },
        Fault { name: "2 degrees", word: "turned by", spoil: |p| of_body(p, [0.0, 0.0, 2.0], [0.0, 0.0, 0.0]) },
    ]
}

/// A folder with the clouds of another one, and these poses.
fn folder(clouds: &Path, times: &[f64], poses: &[Pose], name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("voxelastic-poses-{}-{name}", std::process::id()));
    fs::create_dir_all(&folder).unwrap();
    let link = folder.join("scans");
    if !link.exists() {
        std::os::unix::fs::symlink(clouds, link).unwrap();
    }
    let stamped: Vec<(f64, Pose)> = times.iter().copied().zip(poses.iter().copied()).collect();
    write_tum(folder.join("poses.tum"), &stamped).unwrap();
    folder
}

/// Every fault on one of the sets, and what is right on all.
#[test]
fn faults_of_poses_are_named() {
    matrix(|set, fault| fault.word.is_empty() || fault.name.len() % SETS.len() == set);
}

/// Every fault on every set.
#[test]
#[ignore = "takes a minute and a half; CONTRIBUTING.md has the command"]
fn every_fault_of_poses_is_named_on_every_set() {
    matrix(|_, _| true);
}

fn matrix(is_tried: impl Fn(usize, &Fault) -> bool) {
    let mut wrong = Vec::new();
    for (set, (name, clouds, poses)) in SETS.into_iter().enumerate() {
        let Some(data) = voxelastic_testing::data(name) else { return };
        let options = OpenOptions { poses: Some(poses.into()), ..OpenOptions::default() };
        let Source::Registered(source) = Source::open(&data, &options, None).unwrap() else { panic!() };
        let RegisteredSource::Folder(dataset) = *source else { panic!() };
        let track: Vec<(f64, Pose)> = dataset.scans().iter().map(|scan| (scan.time, scan.t_map_lidar)).collect();
        let times: Vec<f64> = track.iter().map(|(time, _)| *time).collect();
        for fault in faults().into_iter().filter(|fault| is_tried(set, fault)) {
            // Between keyframes, interpolation does not tell where the lidar was: a shift in time is seen there, or too small to be seen, and not named.
            let word = match (name, fault.name.ends_with(" s")) {
                ("hall", true) => "do not fit",
                ("kitti00-street", true) => continue,
                // Along a straight road at constant speed the next pose is as good.
                ("kitti00-seq", _) if fault.name == "one row" => continue,
                _ => fault.word,
            };
            let folder = folder(&data.join(clouds), &times, &(fault.spoil)(&track), name);
            let mut warnings = Warnings::default();
            let (_, found) = Source::open_checked(&folder, &OpenOptions::default(), None, PosesCheck::Warn, &mut warnings).unwrap();
            let said = warnings.all().first().map_or(String::new(), |w| format!("{} -> {}", w.text, w.remedy));
            let is_right = if word.is_empty() { said.is_empty() } else { said.contains(word) };
            let check = found.unwrap().poses.unwrap();
            let line = format!("{name}, {}: {} of {} agree, {:?}: {said}", fault.name, check.agreeing, check.pairs, check.median);
            println!("{} {line}", if is_right { "right" } else { "WRONG" });
            wrong.extend((!is_right).then_some(line));
            fs::remove_dir_all(&folder).unwrap();
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}
