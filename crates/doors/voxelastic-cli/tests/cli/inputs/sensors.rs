//! `live --velodyne` and `--hesai`: packets of a sensor in a room come over UDP, and there is a map of the room.

use crate::{json, voxelastic, works};
use rustix::process::{Pid, Signal, kill_process};
use std::io::{BufRead, BufReader};
use std::net::UdpSocket;
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use voxelastic_testing::packets::{self, Beam, Measured};

/// The walls, floor and ceiling of a room around the sensor, metres: along x, y and z.
const ROOM: [[f64; 2]; 3] = [[-3.0, 5.0], [-2.0, 4.0], [-1.0, 1.5]];
/// UDP may lose datagrams where the system is busy.
const TRIES: usize = 5;
/// Turns of the sensor.
const TURNS: f64 = 12.0;

/// How far it is to the walls.
fn to_the_walls(beam: Beam) -> Measured {
    let (azimuth, elevation) = (beam.azimuth.to_radians(), beam.elevation.to_radians());
    let direction = [elevation.cos() * azimuth.sin(), elevation.cos() * azimuth.cos(), elevation.sin()];
    let to_wall = |([low, high], d): ([f64; 2], f64)| if d.abs() < 1e-9 { f64::INFINITY } else { if d > 0.0 { high / d } else { low / d } };
    (ROOM.into_iter().zip(direction).map(to_wall).fold(f64::INFINITY, f64::min), 100)
}

/// Maps the packets that are sent to a port of this machine, and ends that as a user does.
fn mapped(dir: &Path, make: &str, packets: &[(f64, Vec<u8>)]) -> serde_json::Value {
    let port = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let flags = "--every scan --voxel-size 0.1 --max-range 12 --no-loops --overwrite --restart --json";
    let mut command = voxelastic(dir);
    command.args(["live", make, &format!("127.0.0.1:{port}"), "-o", "room.vox"]).args(flags.split(' '));
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap);
    assert!(lines.by_ref().any(|line| line.contains("listening at the UDP port")), "it ended before it listened");
    let log = std::thread::spawn(move || lines.collect::<Vec<_>>().join("\n"));
    let (socket, begin) = (UdpSocket::bind("127.0.0.1:0").unwrap(), Instant::now());
    for (time, packet) in packets {
        // At half of its speed: machines that test are busy.
        let due = Duration::from_secs_f64(2.0 * (time - packets[0].0));
        std::thread::sleep(due.saturating_sub(begin.elapsed()));
        socket.send_to(packet, ("127.0.0.1", port)).unwrap();
    }
    std::thread::sleep(Duration::from_millis(500));
    kill_process(Pid::from_child(&child), Signal::TERM).unwrap();
    let output = child.wait_with_output().unwrap();
    let log = log.join().unwrap();
    assert_eq!(output.status.code(), Some(0), "{log}");
    serde_json::from_slice(&output.stdout).unwrap()
}

/// How far the corners of a mesh are from the nearest wall, metres, and how long and wide it is, the longer first. Which way a sensor's axes lie does not matter.
fn shape(dir: &Path) -> (f64, [f64; 2]) {
    works(dir, "mesh room.vox -o room.ply");
    let mesh = voxelastic_io::ply::read_mesh(dir.join("room.ply")).unwrap();
    // But for a hundredth at either end, which may be anything.
    let ends = |k: usize| {
        let mut along: Vec<f64> = mesh.positions.iter().map(|p| f64::from(p[k])).collect();
        along.sort_unstable_by(f64::total_cmp);
        [along[along.len() / 100], along[along.len() - 1 - along.len() / 100]]
    };
    let walls = [ends(0), ends(1)];
    let distance = |p: &[f32; 3]| {
        let to = |c: f32, [low, high]: [f64; 2]| (f64::from(c) - low).abs().min((high - f64::from(c)).abs());
        let flat = (f64::from(p[2]) - ROOM[2][0]).abs().min((f64::from(p[2]) - ROOM[2][1]).abs());
        to(p[0], walls[0]).min(to(p[1], walls[1])).min(flat)
    };
    let mut distances: Vec<f64> = mesh.positions.iter().map(distance).collect();
    distances.sort_unstable_by(f64::total_cmp);
    let mut sides = walls.map(|[low, high]| high - low);
    sides.sort_unstable_by(|a, b| b.total_cmp(a));
    (distances[distances.len() * 95 / 100], sides)
}

#[test]
fn packets_of_sensors_that_turn_become_a_map() {
    let dir = tempfile::tempdir().unwrap();
    for make in ["--velodyne", "--hesai"] {
        let attempt = |_| {
            let start = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs_f64().floor();
            let packets = if make == "--hesai" { packets::hesai(start, TURNS, to_the_walls) } else { packets::velodyne(start, TURNS, to_the_walls) };
            let said = mapped(dir.path(), make, &packets);
            println!("{make}: {} scans, {} skipped", said["scans"], said["scans_skipped"]);
            (said["scans"].as_u64() >= Some(8) && said["messages_lost"] == 0).then_some(said)
        };
        let said = (0..TRIES).find_map(attempt).unwrap_or_else(|| panic!("{make}: no try brought the scans"));
        assert!(!said["odometry"].is_null(), "poses are estimated: {said}");
        assert_eq!(json(dir.path(), "info room.vox --check --json")["scans"], said["scans"]);
        let (off, [long, wide]) = shape(dir.path());
        println!("{make}: 95 % of the corners within {off:.3} m of a wall, {long:.2} x {wide:.2} m");
        assert!(off < 0.1 && (long - 8.0).abs() < 0.2 && (wide - 6.0).abs() < 0.2, "{make}: {off} m off, {long} x {wide} m");
    }
}
