//! `live`: the same map as offline, scans that come too fast, signals.

use crate::first_map::content;
use crate::{fails, json, room, run, voxelastic, works};
use std::path::Path;

const QUICK: &str = "--voxel-size 0.1 --max-range 12";

/// The submap files of two maps are the same.
fn assert_same(dir: &Path, one: &str, two: &str) {
    let [one, two] = [one, two].map(|map| content(&dir.join(map)));
    assert!(one.iter().any(|(name, _)| name.ends_with(".vxs")));
    assert!(one == two, "the files of the two maps differ");
}

#[test]
fn the_map_is_that_of_offline_mapping() {
    let dir = tempfile::tempdir().unwrap();
    works(dir.path(), "simulate street -o street --laps 1.3 --spacing 5 --columns 64");
    const STREET: &str = "--voxel-size 0.4 --max-range 20 --field both";
    let offline = json(dir.path(), &format!("map street -o offline.vox {STREET} --json"));
    let live = json(dir.path(), &format!("live --from street -o live.vox --rate max {STREET} --json"));
    assert!(live["corrections"].as_u64().unwrap() >= 5 && live["corrections"] == offline["corrections"].as_array().unwrap().len(), "{live}");
    assert_eq!((&live["scans"], &live["scans_came"], &live["scans_left_out"]), (&offline["scans"], &offline["scans"], &0.into()), "{live}");
    assert_same(dir.path(), "offline.vox", "live.vox");
}

#[test]
fn played_at_its_own_speed_it_is_the_same_map_too() {
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), 8);
    for slam in ["", "--slam"] {
        works(dir.path(), &format!("map room -o offline.vox --overwrite {slam} {QUICK}"));
        let live = json(dir.path(), &format!("live --from room -o live.vox --overwrite {slam} {QUICK} --json"));
        assert!(live["played_s"].as_f64().unwrap() >= 0.69, "eight scans 0.1 s apart: {live}");
        assert_eq!((live["scans"].as_u64(), live["odometry"].is_null()), (Some(8), slam.is_empty()), "{live}");
        assert!(live["delay_p99_ms"].as_f64() >= live["delay_ms"]["median"].as_f64() && live["delay_ms"]["median"].as_f64() > Some(0.0), "{live}");
        assert_same(dir.path(), "offline.vox", "live.vox");
    }
}

#[test]
fn when_scans_come_too_fast_the_newest_win_and_it_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let data = dir.path().join("room");
    room::write(&data, 1);
    for i in 1..200 {
        std::fs::hard_link(data.join("scans/000000.pcd"), data.join(format!("scans/{i:06}.pcd"))).unwrap();
    }
    room::write_poses(&data, 200);
    let done = run(dir.path(), "live --from room --rate 100 --voxel-size 0.02 --json --threads 1");
    assert_eq!(done.code, Some(0), "{}", done.err);
    let live: serde_json::Value = serde_json::from_str(&done.out).unwrap();
    let [scans, came, left_out] = ["scans", "scans_came", "scans_left_out"].map(|key| live[key].as_u64().unwrap());
    assert!(came == 200 && left_out > 0 && scans + left_out == came, "{live}");
    assert!(done.err.contains("came faster than they could be mapped"), "{}", done.err);
    // The last scan was the newest when it came.
    let map = json(dir.path(), "info room.vox --json");
    assert_eq!((map["scans"].as_u64(), map["submaps"].as_array().unwrap().last().unwrap()["last_node"].as_u64()), (Some(scans), Some(199)), "{map}");
}

#[cfg(unix)]
#[test]
fn a_termination_request_saves_what_has_come() {
    use rustix::process::{Pid, Signal, kill_process};
    use std::io::{BufRead, BufReader};
    use std::process::Stdio;
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), 12);
    let arguments = ["live", "--from", "room", "--rate", "0.05", "--json"];
    let mut child = voxelastic(dir.path()).args(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap);
    assert!(lines.by_ref().any(|line| line.contains("sensor:")));
    kill_process(Pid::from_child(&child), Signal::TERM).unwrap();
    let log: String = lines.collect::<Vec<_>>().join("\n");
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130), "{log}");
    let live: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(live["interrupted"] == true && live["scans"].as_u64().unwrap() < 12, "{live}");
    assert_eq!(json(dir.path(), "info room.vox --check --json")["scans"], live["scans"]);
}

/// Starts mapping a room live into `room.vox` and kills that once a checkpoint is there.
fn killed_live(dir: &Path) {
    use std::process::Stdio;
    use std::time::{Duration, Instant};
    let arguments = "live --from room --rate 0.5 --voxel-size 0.1 --max-range 12 --checkpoints 1";
    let mut child = voxelastic(dir).args(arguments.split_whitespace()).stderr(Stdio::null()).spawn().unwrap();
    let clock = Instant::now();
    while !dir.join("room.vox/unfinished/manifest.json").exists() {
        assert!(child.try_wait().unwrap().is_none() && clock.elapsed() < voxelastic_testing::PATIENCE);
        std::thread::sleep(Duration::from_millis(1));
    }
    child.kill().unwrap();
    child.wait().unwrap();
}

/// What `live` says at its end, as JSON, and its log.
fn lived(dir: &Path, arguments: &str) -> (serde_json::Value, String) {
    let done = run(dir, &format!("live --from room {arguments} --json"));
    assert_eq!(done.code, Some(0), "{}", done.err);
    (serde_json::from_str(&done.out).unwrap(), done.err)
}

#[cfg(unix)]
#[test]
fn a_killed_process_is_gone_on_with() {
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), 12);
    works(dir.path(), &format!("map room -o offline.vox {QUICK}"));
    // At the same speed, at another one, and as fast as possible.
    for rate in ["0.5", "20", "max"] {
        killed_live(dir.path());
        let scans = json(dir.path(), "info room.vox/unfinished --check --json")["scans"].as_u64().unwrap();
        fails(dir.path(), &format!("map room {QUICK} --resume"), 1, &["another run", "command was live"]);
        let (live, log) = lived(dir.path(), &format!("--rate {rate} {QUICK}"));
        assert!(scans >= 1 && log.contains(&format!("{scans} scans are mapped")), "{log}");
        assert_eq!([&live["scans"], &live["scans_came"], &live["scans_left_out"]], [12, 12, 0], "{live}");
        assert_eq!(live["scans_resumed"], scans, "{live}");
        // But for the memory of fields, which has depended on their growth.
        let [offline, resumed] = ["offline.vox", "room.vox"].map(|map| crate::faults::resume::content(&dir.path().join(map)));
        assert!(offline == resumed, "the files of the two maps differ");
        assert!(!dir.path().join("room.vox/unfinished").exists());
        std::fs::remove_dir_all(dir.path().join("room.vox")).unwrap();
    }
}

#[test]
fn a_killed_process_that_is_not_gone_on_with_leaves_a_map() {
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), 12);
    for aside in ["room-unfinished.vox", "room-unfinished-2.vox"] {
        killed_live(dir.path());
        let scans = json(dir.path(), "info room.vox/unfinished --json")["scans"].as_u64();
        fails(dir.path(), "live --from room --voxel-size 0.2 --resume", 1, &["voxel_size was 0.1 and is 0.2"]);
        let (live, log) = lived(dir.path(), "--rate max --voxel-size 0.2 --max-range 12 --checkpoints 3");
        assert!(log.contains(&format!("the map {aside}")), "{log}");
        assert_eq!([&live["scans"], &live["scans_resumed"], &live["checkpoints"]["count"]], [12, 0, 4], "{live}");
        assert_eq!(json(dir.path(), &format!("info {aside} --check --json"))["scans"].as_u64(), scans);
        std::fs::remove_dir_all(dir.path().join("room.vox")).unwrap();
    }
    // Nothing is left if that is asked for.
    killed_live(dir.path());
    assert_eq!(lived(dir.path(), &format!("--rate max {QUICK} --restart")).0["scans_resumed"], 0);
    assert!(!dir.path().join("room-unfinished-3.vox").exists() && !dir.path().join("room.vox/unfinished").exists());
    fails(dir.path(), &format!("live --from room {QUICK} --resume"), 1, &["no run that did not end"]);
    fails(dir.path(), "live --from room --resume --restart", 2, &["--restart"]);
}

#[cfg(unix)]
#[test]
fn a_run_that_was_ended_goes_on_too() {
    use rustix::process::{Pid, Signal, kill_process};
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), 12);
    works(dir.path(), &format!("map room -o offline.vox {QUICK}"));
    let arguments = format!("live --from room --rate 1 {QUICK} --checkpoints 1");
    let mut child = voxelastic(dir.path()).args(arguments.split_whitespace()).stderr(std::process::Stdio::null()).spawn().unwrap();
    while !dir.path().join("room.vox/unfinished/manifest.json").exists() {
        assert!(child.try_wait().unwrap().is_none());
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    kill_process(Pid::from_child(&child), Signal::TERM).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130));
    let saved = json(dir.path(), "info room.vox --json")["scans"].as_u64();
    let (live, _) = lived(dir.path(), &format!("--rate max {QUICK}"));
    assert_eq!((live["scans_resumed"].as_u64(), live["scans"].as_u64()), (saved, Some(12)), "{live}");
    // Of a submap whose fields are the same the file of the map that is there is kept, so poses in it may be those of before.
    let of = |map: &str| json(dir.path(), &format!("info {map} --check --json"))["submaps"].clone();
    assert_eq!(of("room.vox").as_array().unwrap().len(), of("offline.vox").as_array().unwrap().len());
}

#[test]
fn impossible_requests_have_a_remedy() {
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), 2);
    fails(dir.path(), "live --from room --explore", 2, &["what is free", "--field both"]);
    fails(dir.path(), "live --from room --explore --field both", 2, &["go nowhere", "--foxglove"]);
    fails(dir.path(), "live --from room --explore-time 60", 2, &["--explore"]);
    fails(dir.path(), "live --from room --explore --explore-speed 0 --field both --foxglove", 2, &["--explore-speed"]);
    fails(dir.path(), "live", 2, &["--from"]);
    fails(dir.path(), "live --from room --rate 0", 2, &["--rate", "max"]);
    fails(dir.path(), "live --from nowhere", 1, &["nowhere"]);
    fails(dir.path(), "live --from room --slam --poses poses.tum", 2, &["--slam", "--poses"]);
    std::fs::write(dir.path().join("room/scans/000001.pcd"), "garbage").unwrap();
    let done = run(dir.path(), "live --from room --json");
    assert_eq!(done.code, Some(0), "{}", done.err);
    assert!(done.out.contains("\"scans_skipped\":1") && done.err.contains("000001.pcd"), "{}", done.err);
    std::fs::write(dir.path().join("room/scans/000000.pcd"), "garbage").unwrap();
    fails(dir.path(), "live --from room -o none.vox", 1, &["no scan could be mapped"]);
    assert!(!dir.path().join("none.vox/manifest.json").exists());
}

/// The answer of the viewer's server to a request.
#[cfg(unix)]
fn asked(address: &str, path: &str) -> String {
    use std::io::{Read, Write};
    let mut stream = std::net::TcpStream::connect(address).unwrap();
    write!(stream, "GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n").unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

/// Runs a command with a viewer until it says that the viewer has all of the map; returns its health, exit code and output.
#[cfg(unix)]
fn watched(dir: &Path, arguments: &str) -> (serde_json::Value, Option<i32>, String) {
    use rustix::process::{Pid, Signal, kill_process};
    use std::io::{BufRead, BufReader};
    use std::process::Stdio;
    let mut child = voxelastic(dir).args(arguments.split_whitespace()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let (mut log, mut address) = (String::new(), String::new());
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap);
    for line in lines.by_ref() {
        address = line.split_once("viewer: http://").map_or(address, |(_, at)| at.trim().to_owned());
        log += &line;
        if line.contains("has all of it") {
            break;
        }
    }
    assert!(asked(&address, "/").contains("<title>room"), "{log}");
    let health = asked(&address, "/health");
    kill_process(Pid::from_child(&child), Signal::INT).unwrap();
    let rest: Vec<String> = lines.collect();
    let output = child.wait_with_output().unwrap();
    let health = serde_json::from_str(health.split_once("\r\n\r\n").unwrap().1).unwrap();
    (health, output.status.code(), log + &rest.join("\n") + &String::from_utf8_lossy(&output.stdout))
}

#[cfg(unix)]
#[test]
fn a_map_can_be_watched_while_it_grows_and_afterwards() {
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), 6);
    works(dir.path(), &format!("map room -o offline.vox {QUICK}"));
    let (health, code, log) = watched(dir.path(), &format!("live --from room --view=127.0.0.1:0 --json {QUICK}"));
    assert_eq!((health["state"].as_str(), health["scans"].as_u64(), code), (Some("finished"), Some(6), Some(0)), "{health} {log}");
    assert!(log.contains("\"scans\":6"), "{log}");
    assert_same(dir.path(), "offline.vox", "room.vox");
    // A viewer changes nothing in the map, and a map is not made by viewing.
    let (health, code, _) = watched(dir.path(), "view room.vox --address 127.0.0.1:0");
    assert_eq!((health["state"].as_str(), health["scans"].as_u64(), code), (Some("a saved map"), Some(6), Some(0)), "{health}");
    std::fs::remove_dir_all(dir.path().join("room.vox")).unwrap();
    let (health, code, _) = watched(dir.path(), "view room --rate max --address 127.0.0.1:0");
    assert_eq!((health["scans"].as_u64(), code, dir.path().join("room.vox").exists()), (Some(6), Some(0), false), "{health}");
}

#[test]
fn how_much_is_said_is_chosen_by_a_flag_or_the_environment() {
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), 4);
    let said = |flag: &str, environment: Option<&str>| {
        let mut command = voxelastic(dir.path());
        command.args(format!("live --from room --rate max --overwrite {flag} {QUICK}").split_whitespace());
        command.envs(environment.map(|levels| ("RUST_LOG", levels)));
        let output = command.output().unwrap();
        assert!(output.status.success() && output.stdout.is_empty(), "{output:?}");
        let text = String::from_utf8(output.stderr).unwrap();
        let of = |level: &str| text.lines().filter(|line| line.trim_start().starts_with(level)).count();
        [of("INFO") > 0, of("DEBUG") >= 4, text.is_empty()]
    };
    assert_eq!(said("", None), [true, false, false]);
    assert_eq!(said("-v", None), [true, true, false], "a line for each scan");
    assert_eq!(said("-q", None), [false, false, true], "nothing but warnings and errors");
    assert_eq!(said("-q", Some("voxelastic=debug")), [true, true, false], "the environment wins");
    assert_eq!(said("-v", Some("error")), [false, false, true]);
}

#[test]
fn impossible_viewers_have_a_remedy() {
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), 1);
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap();
    fails(dir.path(), &format!("live --from room --view={address}"), 1, &["cannot serve the viewer", "port 0"]);
    fails(dir.path(), &format!("view room --address {address}"), 1, &["cannot serve the viewer"]);
    fails(dir.path(), "view room --address nowhere", 2, &["--address"]);
    fails(dir.path(), "view nothing", 1, &["nothing"]);
    fails(dir.path(), "view room --skip-damaged", 2, &["--skip-damaged"]);
    works(dir.path(), "map room");
    fails(dir.path(), "view room.vox --rate 2", 2, &["--rate"]);
}

#[test]
fn a_node_that_explores_plans_and_maps_what_it_would_map_otherwise() {
    let dir = tempfile::tempdir().unwrap();
    let help = works(dir.path(), "live --help");
    for flag in ["--explore ", "--explore-bounds", "--explore-height", "--explore-radius", "--explore-speed", "--explore-time"] {
        assert!(help.contains(flag), "{flag}: {help}");
    }
    room::write(&dir.path().join("room"), 16);
    // Slowly enough that a machine with other work looks for the frontier before the end.
    let flags = format!("--from room --rate 0.5 --field both --robot-radius 0.6 {QUICK} --json");
    let plain = json(dir.path(), &format!("live -o plain.vox --foxglove=127.0.0.1:0 {flags}"));
    let live = json(dir.path(), &format!("live -o explored.vox --foxglove=127.0.0.1:0 --explore --explore-time 600 {flags}"));
    let planned = &live["exploration"];
    assert!(plain["exploration"].is_null() && plain["scans"] == 16 && live["scans"] == 16, "{plain} {live}");
    assert!(planned["looks"].as_u64() > Some(1) && planned["paths"].as_u64() > Some(0) && planned["failures"] == 0, "{planned}");
    // The room has little to see, and nobody follows the path.
    assert!(planned["reason"].is_null() == (planned["state"] == "exploring") && planned["from_home_m"].as_f64() > Some(1.0), "{planned}");
    assert!(planned["copy_p99_ms"].as_f64() > Some(0.0) && planned["plan_ms"]["median"].as_f64() > Some(0.0), "{planned}");
    assert_same(dir.path(), "plain.vox", "explored.vox");
}
