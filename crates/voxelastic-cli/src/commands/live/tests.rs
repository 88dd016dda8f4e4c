//! Scans that come once, and a process that ends at any moment: the next one goes on with its map.

use super::LiveArgs;
use super::source::Source;
use clap::{Args, FromArgMatches};
use std::collections::VecDeque;
use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use voxelastic::Pose;
use voxelastic::atlas::Atlas;
use voxelastic::event::{Edge, Event, NodeId, Scan};
use voxelastic::geometry::PoseExt;
use voxelastic_io::store::MapStore;
use voxelastic_io::{Keyframing, OpenOptions};
use voxelastic_live::transport::Transport;
use voxelastic_run::Input;
use voxelastic_run::poses::{Motions, OdometrySetup, OdometryStage};
use voxelastic_sim::{PoseSource, SimOptions, Simulation};
use voxelastic_slam::slam::RawScan;

/// Gives out inputs, a little apart so that none is left out. Before it begins, it may ask the node something. Before it ends, it copies the map folder as it is:
/// what a process that dies then leaves.
struct Robot {
    inputs: VecDeque<Input>,
    asks: Option<Box<dyn FnOnce() + Send>>,
    dies: Option<[PathBuf; 2]>,
}

impl Transport for Robot {
    fn next(&mut self, _: &dyn Fn() -> bool) -> Option<Input> {
        if let Some(ask) = self.asks.take() {
            ask();
        }
        let next = self.inputs.pop_front();
        let pause = match &next {
            None => 1000,
            Some(input) if input.time().is_some() => 100,
            Some(_) => 0,
        };
        std::thread::sleep(std::time::Duration::from_millis(pause));
        if next.is_none()
            && let Some([map, copy]) = self.dies.take()
        {
            copy_dir(&map, &copy);
        }
        next
    }
}

fn copy_dir(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        let to = to.join(entry.file_name());
        if entry.file_type().unwrap().is_dir() { copy_dir(&entry.path(), &to) } else { assert!(fs::copy(entry.path(), to).is_ok()) }
    }
}

fn world(name: &str) -> Simulation {
    Simulation::new(SimOptions { columns: Some(256), scans: Some(24), spacing: 0.4, ..SimOptions::of(name) }).unwrap()
}

/// Scans `from..to` of a simulation as nodes 0, 1, .. with poses in a frame that lies at `t_map_frame` in the world.
fn given(sim: &Simulation, [from, to]: [usize; 2], t_map_frame: &Pose) -> VecDeque<Input> {
    let pose = |k: usize| t_map_frame.inverse() * sim.poses(PoseSource::Truth)[k];
    let node = |k: usize| (k - from) as NodeId;
    let scan = |k: usize| Event::Scan(Scan { node: node(k), time: 0.1 * k as f64, t_map_lidar: pose(k), cloud: sim.cloud(k).unwrap() });
    let edge = |k: usize| Edge { from: node(k - 1), to: node(k), t_from_to: pose(k - 1).inv_mul(&pose(k)), information: None };
    (from..to).flat_map(|k| [Some(scan(k)), (k > from).then(|| Event::OdometryEdge(edge(k)))]).flatten().map(Input::Event).collect()
}

fn raw(sim: &Simulation, [from, to]: [usize; 2]) -> VecDeque<Input> {
    let scan = |k: usize| RawScan { node: (k - from) as NodeId, time: 0.1 * k as f64, cloud: sim.cloud(k).unwrap(), imu: Vec::new() };
    (from..to).map(|k| Input::RawScan(scan(k), k.to_string())).collect()
}

/// Maps what a robot gives out, as a process of its own would. Returns what it says in the end.
fn live(map: &Path, flags: &str, inputs: VecDeque<Input>, copy: Option<&Path>) -> u8 {
    live_asked(map, flags, inputs, copy, None)
}

fn live_asked(map: &Path, flags: &str, inputs: VecDeque<Input>, copy: Option<&Path>, asks: Option<Box<dyn FnOnce() + Send>>) -> u8 {
    let _ = tracing_subscriber::fmt().with_test_writer().without_time().try_init();
    let command = LiveArgs::augment_args(clap::Command::new("live"));
    let line = format!("live --ouster 7502 --voxel-size 0.1 --max-range 15 --checkpoints 1 --threads 2 {flags} -o");
    let words = line.split(' ').filter(|word| !word.is_empty()).map(std::ffi::OsString::from).chain([map.as_os_str().to_owned()]);
    let args = LiveArgs::from_arg_matches(&command.try_get_matches_from(words).unwrap()).unwrap();
    let is_raw = matches!(inputs.front(), Some(Input::RawScan(..)));
    let robot = Robot { inputs, asks, dies: copy.map(|copy| [map.to_owned(), copy.to_owned()]) };
    let options = OpenOptions { keyframing: Some(Keyframing::All), ..OpenOptions::default() };
    let odometry = is_raw.then(|| OdometryStage::new(OdometrySetup::of_recording(&options), Motions::default(), 2).unwrap());
    args.play(map, true, |_, _, _| Ok(Some(Source::passing(Box::new(robot), odometry, None)))).unwrap()
}

fn atlas(map: &Path) -> Atlas {
    MapStore::open(map).unwrap().load_atlas().unwrap()
}

/// The nodes of a map with their poses, in order.
fn path(atlas: &Atlas) -> Vec<(NodeId, Pose)> {
    let scans =
        atlas.submaps().iter().flat_map(|submap| submap.scans().iter().map(move |scan| (scan.node, submap.t_map_submap() * scan.t_submap_lidar)));
    let mut path: Vec<(NodeId, Pose)> = scans.collect();
    path.sort_by_key(|(node, _)| *node);
    path
}

/// The largest distance between poses and those of a simulation, in the frame of the first.
fn error(path: &[(NodeId, Pose)], sim: &Simulation) -> f64 {
    let truth = sim.poses(PoseSource::Truth);
    let relative = |poses: &[Pose], k: usize| poses[0].inverse() * poses[k];
    let found: Vec<Pose> = path.iter().map(|(_, pose)| *pose).collect();
    (0..found.len()).map(|k| relative(&found, k).translation_distance(&relative(truth, k))).fold(0.0, f64::max)
}

#[test]
fn a_robot_that_is_started_again_goes_on_in_the_same_map() {
    let dir = tempfile::tempdir().unwrap();
    let sim = world("room");
    let elsewhere = Pose::from_parts(nalgebra::Translation3::new(3.0, -2.0, 0.0), nalgebra::UnitQuaternion::from_euler_angles(0.0, 0.0, 0.7));
    // Poses in the frame of before, in another one, and by odometry that begins anew, with loop closures.
    let first = |is_raw: bool| if is_raw { raw(&sim, [0, 12]) } else { given(&sim, [0, 12], &Pose::identity()) };
    let cases: [(&str, &str, bool, VecDeque<Input>); 4] = [
        ("same", "", false, given(&sim, [12, 24], &Pose::identity())),
        ("other", "", false, given(&sim, [12, 24], &elsewhere)),
        ("optimised", "--loops", false, given(&sim, [12, 24], &elsewhere)),
        ("slam", "", true, raw(&sim, [12, 24])),
    ];
    for (name, flags, is_raw, then) in cases {
        let [before, map] = ["-before.vox", ".vox"].map(|end| dir.path().join(format!("{name}{end}")));
        assert_eq!(live(&before, flags, first(is_raw), Some(&map)), 0);
        assert!(!before.join("unfinished").exists());
        let kept = path(&atlas(&map.join("unfinished")));
        assert_eq!(kept.len(), 12, "{name}: what the process leaves");
        // Another one dies, too.
        assert_eq!(live(&map, flags, then.clone(), None), 0);
        let after = path(&atlas(&map));
        assert_eq!(after.iter().map(|(node, _)| *node).collect::<Vec<_>>(), (0..24).collect::<Vec<_>>(), "{name}: nothing is lost");
        let off = error(&after, &sim);
        assert!(off < if name == "same" { 1e-6 } else { 0.15 }, "{name}: {off} m");
        assert!(!map.join("unfinished").exists());
        if name == "same" {
            assert_eq!(live(&dir.path().join("whole.vox"), "", given(&sim, [0, 24], &Pose::identity()), None), 0);
            let submaps = |map: &str| atlas(&dir.path().join(map)).submaps().iter().map(|submap| submap.scans().len()).collect::<Vec<_>>();
            assert_eq!(submaps("same.vox"), submaps("whole.vox"));
        }
    }
}

#[test]
fn scans_of_another_place_begin_a_new_map_and_that_of_before_is_kept() {
    let dir = tempfile::tempdir().unwrap();
    let [before, map] = ["before.vox", "map.vox"].map(|name| dir.path().join(name));
    assert_eq!(live(&before, "", raw(&world("room"), [0, 12]), Some(&map)), 0);
    assert_eq!(live(&map, "", raw(&world("street"), [0, 22]), None), 0);
    assert_eq!(path(&atlas(&dir.path().join("map-unfinished.vox"))).len(), 12);
    let nodes: Vec<NodeId> = path(&atlas(&map)).iter().map(|(node, _)| *node).collect();
    assert!(nodes.len() == 22 && nodes[0] >= 12, "{nodes:?}");
}

/// What the server at `port` answers to a request that has the token.
fn posted(port: u16, path: &str, body: &str) -> String {
    let mut stream = (0..200).find_map(|_| {
        std::thread::sleep(std::time::Duration::from_millis(50));
        TcpStream::connect(("127.0.0.1", port)).ok()
    });
    let stream = stream.as_mut().unwrap();
    let head = format!("Host: localhost\r\nAuthorization: Bearer {TOKEN}\r\nContent-Length: {}\r\nConnection: close", body.len());
    write!(stream, "POST {path} HTTP/1.1\r\n{head}\r\n\r\n{body}").unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

const TOKEN: &str = "a-token-for-this-test";

#[test]
fn a_saved_map_is_loaded_and_mapping_goes_on_in_it() {
    let dir = tempfile::tempdir().unwrap();
    let sim = world("room");
    let [saved, coarse, token] = ["saved.vox", "coarse.vox", "token"].map(|name| dir.path().join(name));
    fs::write(&token, TOKEN).unwrap();
    assert_eq!(live(&saved, "", given(&sim, [0, 12], &Pose::identity()), None), 0);
    assert_eq!(live(&coarse, "--field occupancy", given(&sim, [0, 2], &Pose::identity()), None), 0);
    let elsewhere = Pose::from_parts(nalgebra::Translation3::new(3.0, -2.0, 0.0), nalgebra::UnitQuaternion::from_euler_angles(0.0, 0.0, 0.7));
    // Poses in the frame of the map, in another one, with corrections, and by odometry that begins before the map is loaded.
    let cases = [("same", "", false), ("other", "", false), ("optimised", "--loops", false), ("slam", "", true)];
    for (name, flags, is_raw) in cases {
        let map = dir.path().join(format!("{name}.vox"));
        let frame = if name == "same" { Pose::identity() } else { elsewhere };
        let inputs = if is_raw { raw(&sim, [12, 24]) } else { given(&sim, [12, 24], &frame) };
        let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let (paths, damaged) = ([saved.clone(), coarse.clone()], dir.path().join(format!("{name}-damaged.vox")));
        let ask = move || {
            let load = |path: &Path| posted(port, "/load", path.to_str().unwrap());
            assert!(load(Path::new("nowhere.vox")).contains("nowhere.vox: there is no such map"));
            let refused = load(&paths[1]);
            assert!(refused.starts_with("HTTP/1.1 409") && refused.contains("occupancy"), "{refused}");
            copy_dir(&paths[0], &damaged);
            let file =
                fs::read_dir(&damaged).unwrap().map(|entry| entry.unwrap().path()).find(|path| path.extension().is_some_and(|end| end == "vxs"));
            fs::write(file.unwrap(), "garbage").unwrap();
            let refused = load(&damaged);
            assert!(refused.starts_with("HTTP/1.1 409") && refused.contains("submap"), "{refused}");
            let loaded = load(&paths[0]);
            assert!(loaded.starts_with("HTTP/1.1 200") && loaded.contains("12 scans"), "{loaded}");
        };
        let flags = format!("{flags} --view=127.0.0.1:{port} --token {}", token.display());
        assert_eq!(live_asked(&map, &flags, inputs, None, Some(Box::new(ask))), 0, "{name}");
        let after = path(&atlas(&map));
        assert_eq!(after.len(), 24, "{name}: {:?}", after.iter().map(|(node, _)| *node).collect::<Vec<_>>());
        let off = error(&after, &sim);
        assert!(off < if name == "same" { 1e-6 } else { 0.15 }, "{name}: {off} m");
        assert_eq!(path(&atlas(&saved)).len(), 12, "the map that was loaded is as it was");
    }
}

#[test]
fn a_robot_that_explores_is_held_and_sent_home_on_request() {
    let dir = tempfile::tempdir().unwrap();
    let (sim, token) = (world("room"), dir.path().join("token"));
    fs::write(&token, TOKEN).unwrap();
    for explores in [false, true] {
        let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let ask = move || {
            for (request, words) in [("/explore/pause", "is to stay"), ("/explore", "explores"), ("/explore/home", "goes home")] {
                let (status, words) = if explores { ("200", words) } else { ("409", "start it with --explore") };
                let answer = posted(port, request, "");
                assert!(answer.starts_with(&format!("HTTP/1.1 {status}")) && answer.contains(words), "{request}: {answer}");
            }
        };
        let explore = if explores { "--explore --foxglove=127.0.0.1:0" } else { "" };
        let flags = format!("{explore} --field both --view=127.0.0.1:{port} --token {}", token.display());
        let map = dir.path().join(format!("{explores}.vox"));
        assert_eq!(live_asked(&map, &flags, given(&sim, [0, 4], &Pose::identity()), None, Some(Box::new(ask))), 0);
        assert_eq!(path(&atlas(&map)).len(), 4);
    }
}
