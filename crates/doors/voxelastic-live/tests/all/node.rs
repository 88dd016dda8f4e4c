//! Scans that come once, and a process that ends at any moment: the next one goes on with its map.

use std::collections::VecDeque;
use std::fs;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use voxelastic::atlas::Atlas;
use voxelastic::event::{Edge, Event, NodeId, Scan};
use voxelastic::geometry::PoseExt;
use voxelastic::settings::FieldKind;
use voxelastic::{Pose, Settings};
use voxelastic_io::store::MapStore;
use voxelastic_io::{Keyframing, OpenOptions};
use voxelastic_live::node::{KeptIn, NetworkSetup, ScansFrom, Setup, ViewerSetup, play};
use voxelastic_live::planner::PlannerSettings;
use voxelastic_live::ros::names::Names;
use voxelastic_live::transport::Transport;
use voxelastic_run::keep::{CheckpointEvery, Resume, SaveOptions};
use voxelastic_run::poses::{Motions, OdometrySetup, OdometryStage};
use voxelastic_run::{Corrections, Input};
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

pub fn world(name: &str) -> Simulation {
    Simulation::new(SimOptions { columns: Some(256), scans: Some(24), spacing: 0.4, ..SimOptions::of(name) }).unwrap()
}

/// Scans `from..to` of a simulation as nodes 0, 1, .. with poses in a frame that lies at `t_map_frame` in the world.
pub fn given(sim: &Simulation, [from, to]: [usize; 2], t_map_frame: &Pose) -> VecDeque<Input> {
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

/// A node that keeps its map at `map`.
pub fn setup(map: &Path) -> Setup {
    Setup {
        name: PathBuf::from("live"),
        reading: OpenOptions::default(),
        settings: Settings { voxel_size: 0.1, max_range: 15.0, threads: 2, ..Settings::default() },
        corrections: Corrections::default(),
        viewer: None,
        kept: Some(KeptIn {
            path: map.to_owned(),
            save: SaveOptions::default(),
            resume: Resume::default(),
            checkpoints: "1".parse::<CheckpointEvery>().unwrap(),
        }),
        network: None,
        keep_scans: 1 << 30,
        planner: None,
        is_stopped: || false,
    }
}

/// A node that finds loops in scans that have poses.
fn with_loops(setup: Setup) -> Setup {
    Setup { corrections: Corrections { loops: Some(true), ..setup.corrections }, ..setup }
}

/// A viewer at `port` with the token in a file.
fn viewer(port: u16, token: &Path) -> Option<ViewerSetup> {
    Some(ViewerSetup { address: SocketAddr::from(([127, 0, 0, 1], port)), origins: Vec::new(), detail: 1, link: None, token: Some(token.to_owned()) })
}

/// Maps what a robot gives out, as a process of its own would.
pub fn live(setup: &Setup, inputs: VecDeque<Input>, copy: Option<&Path>) {
    live_asked(setup, inputs, copy, None);
}

fn live_asked(setup: &Setup, inputs: VecDeque<Input>, copy: Option<&Path>, asks: Option<Box<dyn FnOnce() + Send>>) {
    let is_raw = matches!(inputs.front(), Some(Input::RawScan(..)));
    let map = setup.kept.as_ref().unwrap().path.clone();
    let robot = Robot { inputs, asks, dies: copy.map(|copy| [map, copy.to_owned()]) };
    let options = OpenOptions { keyframing: Some(Keyframing::All), ..OpenOptions::default() };
    let odometry = is_raw.then(|| Box::new(OdometryStage::new(OdometrySetup::of_recording(&options), Motions::default(), 2).unwrap()));
    let mut played = play(setup, ScansFrom::Transport(Box::new(robot), odometry), &mut |_| {}).unwrap().unwrap();
    played.save().unwrap();
    played.end(|| true);
}

pub fn atlas(map: &Path) -> Atlas {
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
    let cases: [(&str, bool, VecDeque<Input>); 4] = [
        ("same", false, given(&sim, [12, 24], &Pose::identity())),
        ("other", false, given(&sim, [12, 24], &elsewhere)),
        ("optimised", false, given(&sim, [12, 24], &elsewhere)),
        ("slam", true, raw(&sim, [12, 24])),
    ];
    for (name, is_raw, then) in cases {
        let node = |map: &Path| if name == "optimised" { with_loops(setup(map)) } else { setup(map) };
        let [before, map] = ["-before.vox", ".vox"].map(|end| dir.path().join(format!("{name}{end}")));
        live(&node(&before), first(is_raw), Some(&map));
        assert!(!before.join("unfinished").exists());
        let kept = path(&atlas(&map.join("unfinished")));
        assert_eq!(kept.len(), 12, "{name}: what the process leaves");
        // Another one dies, too.
        live(&node(&map), then.clone(), None);
        let after = path(&atlas(&map));
        assert_eq!(after.iter().map(|(node, _)| *node).collect::<Vec<_>>(), (0..24).collect::<Vec<_>>(), "{name}: nothing is lost");
        let off = error(&after, &sim);
        assert!(off < if name == "same" { 1e-6 } else { 0.15 }, "{name}: {off} m");
        assert!(!map.join("unfinished").exists());
        if name == "same" {
            live(&setup(&dir.path().join("whole.vox")), given(&sim, [0, 24], &Pose::identity()), None);
            let submaps = |map: &str| atlas(&dir.path().join(map)).submaps().iter().map(|submap| submap.scans().len()).collect::<Vec<_>>();
            assert_eq!(submaps("same.vox"), submaps("whole.vox"));
        }
    }
}

#[test]
fn scans_of_another_place_begin_a_new_map_and_that_of_before_is_kept() {
    let dir = tempfile::tempdir().unwrap();
    let [before, map] = ["before.vox", "map.vox"].map(|name| dir.path().join(name));
    live(&setup(&before), raw(&world("room"), [0, 12]), Some(&map));
    live(&setup(&map), raw(&world("street"), [0, 22]), None);
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
    live(&setup(&saved), given(&sim, [0, 12], &Pose::identity()), None);
    let occupancy = Settings { field: FieldKind::Occupancy, ..setup(&coarse).settings };
    live(&Setup { settings: occupancy, ..setup(&coarse) }, given(&sim, [0, 2], &Pose::identity()), None);
    let elsewhere = Pose::from_parts(nalgebra::Translation3::new(3.0, -2.0, 0.0), nalgebra::UnitQuaternion::from_euler_angles(0.0, 0.0, 0.7));
    // Poses in the frame of the map, in another one, with corrections, and by odometry that begins before the map is loaded.
    for (name, is_raw) in [("same", false), ("other", false), ("optimised", false), ("slam", true)] {
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
        let node = Setup { viewer: viewer(port, &token), ..setup(&map) };
        live_asked(&if name == "optimised" { with_loops(node) } else { node }, inputs, None, Some(Box::new(ask)));
        let after = path(&atlas(&map));
        assert_eq!(after.len(), 24, "{name}: {:?}", after.iter().map(|(node, _)| *node).collect::<Vec<_>>());
        let off = error(&after, &sim);
        assert!(off < if name == "same" { 1e-6 } else { 0.15 }, "{name}: {off} m");
        assert_eq!(path(&atlas(&saved)).len(), 12, "the map that was loaded is as it was");
    }
}

#[cfg(feature = "foxglove")]
/// What is published goes to Foxglove alone.
fn foxglove() -> NetworkSetup {
    let foxglove = Some(SocketAddr::from(([127, 0, 0, 1], 0)));
    NetworkSetup {
        names: Names::default(),
        transforms: true,
        grid: voxelastic_live::ros::output::GridSettings::default(),
        lifecycle: false,
        backend: None,
        domain: None,
        is_local: true,
        use_sim_time: false,
        foxglove,
        origins: Vec::new(),
        link: None,
        record: None,
    }
}

#[cfg(feature = "foxglove")]
fn planner() -> PlannerSettings {
    PlannerSettings { radius: 0.3, margin: 0.1, height: None, speed: 1.0, bounds: None, time: None, max_range: 15.0, least_volume: 4.0 }
}

#[cfg(feature = "foxglove")]
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
        let map = dir.path().join(format!("{explores}.vox"));
        let settings = Settings { field: FieldKind::Both, ..setup(&map).settings };
        let (network, planner) = (explores.then(foxglove), explores.then(planner));
        let node = Setup { settings, viewer: viewer(port, &token), network, planner, ..setup(&map) };
        live_asked(&node, given(&sim, [0, 4], &Pose::identity()), None, Some(Box::new(ask)));
        assert_eq!(path(&atlas(&map)).len(), 4);
    }
}
