//! ROS 2 over DDS and over Zenoh, on the loopback interface, with somebody else's implementation at the other end: Cyclone DDS and Zenoh's own library, in
//! Python. Points are compared both ways.

#![cfg(unix)]

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::channel;
use std::time::{Duration, Instant};
use voxelastic::event::{Event, Scan};
use voxelastic::{Mapper, Pose, Settings};
use voxelastic_explore::{FrontierSettings, Frontiers};
use voxelastic_io::bag::live::LiveTopics;
use voxelastic_io::{Keyframing, OpenOptions};
use voxelastic_live::planner::Plan;
use voxelastic_live::ros::dds::Dds;
use voxelastic_live::ros::discovery::discover;
use voxelastic_live::ros::input::TopicInput;
use voxelastic_live::ros::messages::Health;
#[cfg(feature = "foxglove")]
use voxelastic_live::ros::middleware::{Answer, Deliver, Handle, MiddlewareError, Sink};
use voxelastic_live::ros::middleware::{Delivery, Middleware, NodeOptions, Parameter, TopicProfile};
use voxelastic_live::ros::names::Names;
use voxelastic_live::ros::output::{OdometryLink, OutputOptions, Outputs};
use voxelastic_live::ros::services::{Distance, NotLoaded, Pending, Request, RequestSender, Response, offer};
use voxelastic_live::ros::zenoh::Zenoh;
use voxelastic_live::transport::Transport;
use voxelastic_plan::anchor_path;
use voxelastic_run::Input;
use voxelastic_sim::{PoseSource, SimOptions, Simulation};
use voxelastic_testing::{Domain, PATIENCE};

/// A program at the other end; it ends with the test.
struct Peer(Child);

impl Peer {
    /// `script` in `mode`, reached at `place`, with the files of `folder`; none without Python and its modules.
    fn start(script: &str, modules: &str, [mode, place]: [&str; 2], folder: &Path) -> Option<Self> {
        let python = voxelastic_testing::python(modules)?;
        let script = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/ros2").join(script);
        let mut command = Command::new(python);
        command.arg("-B").arg(script).args([mode, place]).arg(folder).stdin(Stdio::null());
        // Discovery over the loopback interface only.
        let interface = "<CycloneDDS><Domain id='any'><General><Interfaces><NetworkInterface name='lo' multicast='true'/></Interfaces>\
            <MaxMessageSize>60000B</MaxMessageSize></General></Domain></CycloneDDS>";
        command.env("CYCLONEDDS_URI", interface);
        Some(Self(command.spawn().unwrap()))
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn options(domain: u16) -> NodeOptions {
    let parameters = [("field", Parameter::Text("both".into())), ("voxel_size", Parameter::Number(0.1))];
    let parameters = parameters.map(|(name, value)| (name.to_owned(), value)).into();
    NodeOptions { name: "voxelastic".into(), domain, local_only: true, parameters, ..NodeOptions::default() }
}

/// Answers a request as a node might.
fn answer(pending: Pending) {
    let response = match &pending.request {
        Request::Save => Response::Done(Ok("saved in map.vox".into())),
        Request::Explore(true) => Response::Done(Ok("explores".into())),
        Request::ReturnHome => Response::Done(Ok("goes home".into())),
        Request::Load(path) if path.as_path() == Path::new("/maps/a.vox") => {
            Response::Loaded(Err((NotLoaded::Differs, "its voxels are wider".into())))
        }
        Request::Distances(points) => {
            let known = |p: &[f64; 3]| (p[0] < 100.0).then_some(Distance { distance: p[2] as f32, gradient: [0.0, 0.0, 1.0] });
            Response::Distances(Ok(points.iter().map(known).collect()))
        }
        _ => Response::Done(Err("no".into())),
    };
    pending.answer(response);
}

/// What a partner that asked for distances and parameters must have got.
fn check_answers(answers: &serde_json::Value) {
    assert_eq!(answers["load"], 3, "{answers}");
    assert_eq!(answers["distances"], serde_json::json!([[true, false], [3.0, null], [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]]));
    assert_eq!(answers["parameters"], serde_json::json!([[3, 0.1, ""], [4, 0.0, "both"], [0, 0.0, ""]]));
    assert_eq!([&answers["explore"], &answers["return_home"]], [&serde_json::json!([true, "explores"]), &serde_json::json!([true, "goes home"])]);
}

/// Where to connect to a Zenoh session of this machine.
fn locator(zenoh: &Zenoh) -> String {
    zenoh.locators().into_iter().find(|locator| locator.starts_with("tcp/127.0.0.1")).unwrap()
}

/// Three scans of different sizes, one of them larger than any packet.
fn scans() -> Vec<Vec<[f32; 3]>> {
    [101, 65_536, 2_000].map(|n| (0..n).map(|k| [5.0 + (k % 97) as f32 * 0.01, (k % 13) as f32 - 6.0, k as f32 * 1e-4]).collect()).into()
}

fn write_scans(folder: &Path) {
    for (k, points) in scans().iter().enumerate() {
        let bytes: Vec<u8> = points.iter().flatten().flat_map(|c| c.to_le_bytes()).collect();
        std::fs::write(folder.join(format!("scan-{k}.f32")), bytes).unwrap();
    }
}

/// Takes scans from a peer that gives them, and compares them with what it was given.
fn scans_come_as_they_were_sent(middleware: &mut dyn Middleware, folder: &Path) {
    let options = OpenOptions { keyframing: Some(Keyframing::All), ..OpenOptions::default() };
    let begin = Instant::now();
    let found = discover(middleware, &Names::default(), &options, false, &|| begin.elapsed() > PATIENCE).unwrap();
    let (topics, is_raw): (LiveTopics, bool) = found.expect("the topics are found by their types");
    assert!(!is_raw && topics.description().contains("/points") && topics.description().contains("/odom"), "{}", topics.description());
    let mut input = TopicInput::subscribe(middleware, topics, is_raw, &options, &|_| Ok(None)).unwrap();
    let (sent, mut seen) = (scans(), HashSet::new());
    let mut frames = None;
    while seen.len() < sent.len() {
        assert!(begin.elapsed() < PATIENCE, "only {seen:?} of the scans came");
        match input.next(&|| begin.elapsed() > PATIENCE) {
            Some(Input::Event(Event::Scan(scan))) => {
                let k = ((scan.time - 1000.0) * 10.0).round();
                let which = k as usize % sent.len();
                assert_eq!(scan.cloud.points, sent[which], "scan {k}");
                // The first scans may come before the transform that was published before them.
                let mounted = 0.25 * k + 0.5;
                if (scan.t_map_lidar.translation.x - mounted).abs() < 1e-6 {
                    seen.insert(which);
                }
                frames = frames.or_else(|| Some(input.frames()));
            }
            Some(Input::Event(_)) => {}
            other => panic!("{other:?}"),
        }
    }
    let frames = frames.unwrap();
    assert_eq!((frames.odom().as_deref(), frames.base().unwrap().0.as_str()), (Some("odom"), "base"));
    std::fs::write(folder.join("done"), "").unwrap();
}

#[test]
fn scans_come_over_dds() {
    let (dir, domain) = (tempfile::tempdir().unwrap(), Domain::free());
    write_scans(dir.path());
    let Some(_peer) = Peer::start("dds_peer.py", "cyclonedds", ["give", &domain.number().to_string()], dir.path()) else { return };
    scans_come_as_they_were_sent(&mut Dds::open(&options(domain.number())).unwrap(), dir.path());
}

#[test]
fn scans_come_over_zenoh() {
    let dir = tempfile::tempdir().unwrap();
    write_scans(dir.path());
    let mut zenoh = Zenoh::open(&options(0)).unwrap();
    let Some(_peer) = Peer::start("zenoh_peer.py", "zenoh, rosbags, numpy", ["give", &locator(&zenoh)], dir.path()) else { return };
    scans_come_as_they_were_sent(&mut zenoh, dir.path());
}

/// A map of a simulated room with both fields, and its scans.
fn room() -> (Mapper, Vec<Scan>) {
    let mut settings = Settings { voxel_size: 0.1, max_range: 12.0, ..Settings::default() };
    settings.set("field", "both").unwrap();
    let mut mapper = Mapper::new(settings).unwrap();
    let simulation = Simulation::new(SimOptions { scans: Some(4), columns: Some(256), ..SimOptions::of("room") }).unwrap();
    let scans: Vec<Scan> = simulation.scans(PoseSource::Truth).collect();
    for scan in &scans {
        mapper.handle(Event::Scan(scan.clone())).unwrap();
    }
    (mapper, scans)
}

/// Somewhere to go in the map of a room, and the map's frontier.
fn plan(mapper: &Mapper) -> Plan {
    let atlas = mapper.atlas();
    let mut frontiers = Frontiers::new(FrontierSettings::default(), [[-20.0; 3], [20.0; 3]]);
    frontiers.update(atlas);
    let mut plan = Plan::default();
    plan.frontier = frontiers.clusters(atlas, &atlas.query().unwrap());
    plan.path = vec![[0.5, 0.25, 1.0], [1.5, 0.25, 1.0], [1.5, 2.0, 1.25]];
    plan.anchors = anchor_path(atlas, &plan.path);
    plan
}

/// Publishes the map of a room and where to go in it, lets a peer that comes late take it, and compares.
fn the_map_goes_out_as_it_is(middleware: &mut dyn Middleware, folder: &Path, start: impl FnOnce() -> Option<Peer>) -> Option<serde_json::Value> {
    let (mapper, scans) = room();
    let mut outputs = Outputs::new(OutputOptions { explores: true, ..OutputOptions::default() });
    outputs.add(middleware, &Names::default()).unwrap();
    let (sender, requests) = channel();
    let _services = offer(middleware, &Names::default(), &RequestSender::new(sender)).unwrap();
    for scan in &scans {
        outputs.add_scan(scan.node, scan.time);
    }
    let last = scans.last().unwrap();
    let odom = Pose::translation(-2.0, 0.0, 0.0) * last.t_map_lidar;
    let link = OdometryLink { odom: "odom".into(), t_odom_lidar: odom, node: last.node, time: last.time, base: None };
    outputs.note(&mapper, Some(link));
    outputs.publish_plan(mapper.atlas(), &plan(&mapper));
    let _peer = start()?;
    let begin = Instant::now();
    while !folder.join("taken.json").exists() {
        assert!(begin.elapsed() < PATIENCE, "the peer has not got everything");
        if !outputs.step(mapper.atlas()) {
            std::thread::sleep(Duration::from_millis(5));
        }
        if outputs.is_time_for_diagnostics() {
            outputs.diagnostics("voxelastic", (Health::Ok, "mapping".into(), vec![("scans".into(), "4".into())]));
        }
        while let Ok(pending) = requests.try_recv() {
            answer(pending);
        }
    }
    let taken: serde_json::Value = serde_json::from_slice(&std::fs::read(folder.join("taken.json")).unwrap()).unwrap();
    compare(&taken, folder, &mapper, &scans);
    Some(taken)
}

fn compare(taken: &serde_json::Value, folder: &Path, mapper: &Mapper, scans: &[Scan]) {
    // Points: every vertex of the surface that is extracted here, and no others.
    let points = std::fs::read(folder.join("points")).unwrap();
    let step = taken["point_step"].as_u64().unwrap() as usize;
    let theirs: HashSet<[u8; 12]> = points.chunks_exact(step).map(|p| *p.first_chunk::<12>().unwrap()).collect();
    let ours = surface(mapper);
    assert!(ours.len() > 1000 && theirs == ours, "{} points are published, {} taken", ours.len(), theirs.len());
    let numbers = |key: &str| -> Vec<serde_json::Value> { taken[key].as_array().unwrap().clone() };
    assert_eq!(taken["path"].as_array().unwrap().len(), scans.len());
    for (theirs, scan) in numbers("path").iter().zip(scans) {
        let theirs: [f64; 3] = serde_json::from_value(theirs.clone()).unwrap();
        assert!((0..3).all(|k| (theirs[k] - scan.t_map_lidar.translation.vector[k]).abs() < 1e-6), "{theirs:?}");
    }
    assert!(numbers("stamps").iter().zip(scans).all(|(theirs, scan)| (theirs.as_f64().unwrap() - scan.time).abs() < 1e-6));
    assert_eq!(taken["submaps"].as_u64().unwrap() as usize, mapper.atlas().submaps().len());
    assert_eq!(taken["tf"][0], "map");
    assert_eq!(taken["tf"][1], "odom");
    assert!((taken["tf"][2].as_f64().unwrap() - 2.0).abs() < 1e-6, "{}", taken["tf"]);
    let query = mapper.atlas().query().unwrap();
    let cubes = query.resample(&voxelastic::query::Resampling { voxel: query.voxel_size(), states_only: true });
    assert_eq!(std::fs::read(folder.join("octomap")).unwrap(), voxelastic_io::octomap::state_nodes(&cubes).unwrap());
    assert_eq!(taken["resolution"].as_f64().unwrap(), query.voxel_size());
    let grid: [u64; 5] = serde_json::from_value(taken["grid"].clone()).unwrap();
    assert!(grid[0] * grid[1] == grid[2] && grid[3] > 1000 && grid[4] > 50, "{grid:?}");
    let plan = plan(mapper);
    let near = |a: &[f64], b: &[f64]| a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6);
    let path: Vec<[f64; 3]> = serde_json::from_value(taken["explore_path"].clone()).unwrap();
    assert!(path.len() == 3 && path.iter().zip(&plan.path).all(|(theirs, ours)| near(theirs, ours)), "{path:?}");
    let goal: [f64; 3] = serde_json::from_value(taken["explore_goal"].clone()).unwrap();
    assert!(near(&goal, &plan.path[2]), "{goal:?}");
    let boxes: Vec<[f64; 6]> = serde_json::from_value(taken["frontier"].clone()).unwrap();
    let ours = plan.frontier.iter().map(|cluster| [cluster.centre, cluster.extent.map(|edge| edge.max(0.1))].concat());
    assert!(boxes.len() > 3 && boxes.len() == plan.frontier.len() && boxes.iter().zip(ours).all(|(theirs, ours)| near(theirs, &ours)), "{boxes:?}");
}

/// The vertices of the one surface in the map frame, as it is published: level of detail 1, tile by tile.
fn surface(mapper: &Mapper) -> HashSet<[u8; 12]> {
    use voxelastic::meshing::{SurfaceChanges, TileMaker};
    let mut changes = SurfaceChanges::default();
    changes.note(mapper.atlas());
    let tiles: Vec<_> = changes.waiting().collect();
    let mut maker = TileMaker::new(voxelastic::surface::MeshOptions { lod: 1, ..Default::default() });
    let vertices = maker.make(&changes.gather(mapper.atlas(), &tiles)).meshes.into_iter().flat_map(|(_, mesh)| mesh.positions);
    vertices.map(|p| p.map(f32::to_le_bytes).concat().try_into().unwrap()).collect()
}

#[test]
fn the_map_goes_out_over_dds() {
    let (dir, domain) = (tempfile::tempdir().unwrap(), Domain::free());
    let mut dds = Dds::open(&options(domain.number())).unwrap();
    let start = || Peer::start("dds_peer.py", "cyclonedds", ["take", &domain.number().to_string()], dir.path());
    the_map_goes_out_as_it_is(&mut dds, dir.path(), start);
}

#[test]
fn the_map_goes_out_over_zenoh() {
    let dir = tempfile::tempdir().unwrap();
    let mut zenoh = Zenoh::open(&options(0)).unwrap();
    let place = locator(&zenoh);
    let start = || Peer::start("zenoh_peer.py", "zenoh, rosbags, numpy", ["take", &place], dir.path());
    let Some(taken) = the_map_goes_out_as_it_is(&mut zenoh, dir.path(), start) else { return };
    assert!(taken["corners"].as_u64().unwrap() > 3000, "{taken}");
    assert_eq!(taken["diagnostics"]["scans"], "4");
    assert_eq!(taken["saved"], serde_json::json!([true, "saved in map.vox"]));
    let answers = &taken["services"];
    check_answers(answers);
    assert_eq!(
        (&answers["names"], &answers["described"]),
        (&serde_json::json!(["field", "voxel_size"]), &serde_json::json!(["voxel_size", 3, true]))
    );
    assert_eq!(answers["set"][0][0], false);
    assert!(answers["set"][0][1].as_str().unwrap().contains("start the node with another value"), "{answers}");
}

#[test]
fn clients_on_cyclone_dds_call_the_services() {
    let (dir, domain) = (tempfile::tempdir().unwrap(), Domain::free());
    let mut dds = Dds::open(&NodeOptions { for_cyclone: true, ..options(domain.number()) }).unwrap();
    let (sender, requests) = channel();
    let _services = offer(&mut dds, &Names::default(), &RequestSender::new(sender)).unwrap();
    let Some(_peer) = Peer::start("dds_peer.py", "cyclonedds", ["ask", &domain.number().to_string()], dir.path()) else { return };
    let (begin, path) = (Instant::now(), dir.path().join("answers.json"));
    while !path.exists() {
        assert!(begin.elapsed() < PATIENCE, "the peer has not got all answers");
        if let Ok(pending) = requests.recv_timeout(Duration::from_millis(50)) {
            answer(pending);
        }
    }
    let answers: serde_json::Value = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
    check_answers(&answers);
    assert_eq!((&answers["save"], &answers["pause"]), (&serde_json::json!([true, "saved in map.vox"]), &serde_json::json!([false, "no"])));
}

/// The server of Foxglove's protocol as a network on which nobody else publishes.
#[cfg(feature = "foxglove")]
struct Foxglove(voxelastic_live::ros::foxglove::FoxgloveServer);

#[cfg(feature = "foxglove")]
impl Middleware for Foxglove {
    fn name(&self) -> &'static str {
        "Foxglove"
    }
    fn published(&self) -> Vec<(String, String)> {
        Vec::new()
    }
    fn subscribe(&mut self, _: &TopicProfile, _: Deliver) -> Result<Handle, MiddlewareError> {
        Ok(Handle::new(()))
    }
    fn advertise(&mut self, topic: &TopicProfile) -> Result<Box<dyn Sink>, MiddlewareError> {
        self.0.advertise(topic)
    }
    fn serve(&mut self, _: &str, _: &str, _: Answer) -> Result<Handle, MiddlewareError> {
        Ok(Handle::new(()))
    }
}

#[cfg(feature = "foxglove")]
#[test]
fn the_map_goes_out_over_foxglove() {
    let Some(modules) = voxelastic_testing::node_modules() else { return };
    let dir = tempfile::tempdir().unwrap();
    let server = voxelastic_live::ros::foxglove::FoxgloveServer::start("voxelastic", ([127, 0, 0, 1], 0).into(), Vec::new()).unwrap();
    let address = server.address().to_string();
    let start = || {
        let script = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/foxglove/client.mjs");
        let mut command = Command::new("node");
        command.arg(script).arg(address).arg(dir.path()).env("VOXELASTIC_NODE_MODULES", modules).stdin(Stdio::null());
        Some(Peer(command.spawn().unwrap()))
    };
    let taken = the_map_goes_out_as_it_is(&mut Foxglove(server), dir.path(), start).unwrap();
    assert!(taken["corners"].as_u64().unwrap() > 3000, "{taken}");
}

#[test]
fn messages_of_any_length_arrive_as_they_were_sent() {
    let domain = Domain::free();
    let [mut from, mut to] =
        [Dds::open(&NodeOptions { name: "sender".into(), ..options(domain.number()) }).unwrap(), Dds::open(&options(domain.number())).unwrap()];
    let (sender, messages) = channel();
    let profile = TopicProfile { name: "/points".into(), kind: "sensor_msgs/msg/PointCloud2".into(), delivery: Delivery::Latched, depth: 50 };
    let mut sink = from.advertise(&profile).unwrap();
    let _subscription = to.subscribe(&profile, Box::new(move |message| drop(sender.send(message)))).unwrap();
    let sent: Vec<Vec<u8>> = (0..40u8).map(|n| [0, 1, 0, 0].into_iter().chain((0..n).map(|k| k.wrapping_mul(31))).collect()).collect();
    sent.iter().for_each(|message| sink.publish(message).unwrap());
    let begin = Instant::now();
    let mut got = Vec::new();
    while got.len() < sent.len() && begin.elapsed() < PATIENCE {
        got.extend(messages.recv_timeout(Duration::from_millis(100)));
    }
    // Also those from before the subscription. DDS fills up to four bytes.
    let filled = |message: &Vec<u8>| [message.as_slice(), &vec![0; message.len().next_multiple_of(4) - message.len()]].concat();
    assert!(got == sent.iter().map(filled).collect::<Vec<_>>(), "{} of {} messages", got.len(), sent.len());
}
