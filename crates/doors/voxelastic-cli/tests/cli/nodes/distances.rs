//! The service `~/distances` of a node that maps, called over Zenoh by somebody else's program, against the map that the node saves, and against the room.

use crate::{room, voxelastic};
use rustix::process::{Pid, Signal, kill_process};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use voxelastic::atlas::Atlas;
use voxelastic::field::occupancy::State;
use voxelastic::query::{AtlasQuery, DistanceQuery};
use voxelastic_esdf::{Esdf, EsdfSettings};
use voxelastic_io::poses;
use voxelastic_io::store::MapStore;
use voxelastic_testing::PATIENCE;

/// Scans that are mapped when the node is asked; one more comes so much later that the test is over by then.
const SCANS: usize = 16;
const VOXEL: f64 = 0.1;

/// Points in the room and around it, metres.
fn points() -> Vec<[f64; 3]> {
    let mut random = 7u64;
    let mut next = |[low, high]: [f64; 2]| {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        low + (high - low) * ((random >> 11) as f64 / (1u64 << 53) as f64)
    };
    (0..3000).map(|_| std::array::from_fn(|k| next([room::MIN[k] - 0.5, room::MAX[k] + 0.5]))).collect()
}

fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// What a node answers that has mapped the room, and the map that it saves.
fn asked(dir: &Path, python: &str, field: &str) -> (serde_json::Value, Atlas) {
    let (port, page) = (free_port(), free_port());
    let script = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/cli/nodes/distances.py");
    let health = format!("http://127.0.0.1:{page}/health");
    let _ = std::fs::remove_file(dir.join("answer.json"));
    let mut asking = Command::new(python);
    let mut asking = asking.arg("-B").arg(script).args([port.to_string(), health, SCANS.to_string()]).arg(dir).stdin(Stdio::null()).spawn().unwrap();
    let flags = format!("--voxel-size {VOXEL} --max-range 12 --field {field} --every scan --restart --overwrite --view=127.0.0.1:{page}");
    let mut command = voxelastic(dir);
    command.args(["-q", "live", "--from", "room", "--ros2=zenoh", "-o", "room.vox"]).args(flags.split(' '));
    let mut node = command.env("ZENOH_CONFIG_OVERRIDE", format!("connect/endpoints=[\"tcp/127.0.0.1:{port}\"]")).spawn().unwrap();
    let clock = Instant::now();
    let done = loop {
        if let Some(done) = asking.try_wait().unwrap() {
            break done;
        }
        assert!(node.try_wait().unwrap().is_none() && clock.elapsed() < PATIENCE, "no answer");
        std::thread::sleep(Duration::from_millis(20));
    };
    kill_process(Pid::from_child(&node), Signal::TERM).unwrap();
    node.wait().unwrap();
    assert!(done.success());
    let answer = serde_json::from_slice(&std::fs::read(dir.join("answer.json")).unwrap()).unwrap();
    let store = MapStore::open(dir.join("room.vox")).unwrap();
    (answer, store.load_atlas().unwrap())
}

/// Distance and gradient that the library finds in a map; none where it knows nothing.
fn in_map(atlas: &Atlas, points: &[[f64; 3]]) -> Vec<Option<(f32, [f32; 3])>> {
    let space = AtlasQuery::new(atlas);
    if space.is_empty() {
        let found = DistanceQuery::new(atlas).sample_many(points).into_iter();
        return found.map(|sample| sample.map(|at| (at.distance.abs(), at.gradient.map(|c| c * at.distance.signum())))).collect();
    }
    let most = EsdfSettings::default().max_distance.min(48.0 * VOXEL);
    let mut esdf = Esdf::new(EsdfSettings { max_distance: most, ..EsdfSettings::default() }, VOXEL as f32).unwrap();
    esdf.update(atlas);
    let samples = esdf.query(atlas).sample_many_to_surfaces(points).into_iter().zip(space.states(points));
    samples.map(|(sample, state)| (state != State::Unknown).then_some((sample.distance, sample.gradient))).collect()
}

/// Distance of a point in the room to its walls and the pillar, metres.
fn in_room(p: &[f64; 3]) -> f64 {
    let walls = (0..3).map(|k| (p[k] - room::MIN[k]).min(room::MAX[k] - p[k])).fold(f64::INFINITY, f64::min);
    let outside = |c: f64, low: f64, high: f64| (low - c).max(c - high);
    let [x, y] = [outside(p[0], 4.0, 4.5), outside(p[1], 1.5, 2.0)];
    let pillar = if x.max(y) < 0.0 { -x.max(y) } else { x.max(0.0).hypot(y.max(0.0)) };
    walls.min(pillar)
}

/// The published slice has the points around the robot of which the map knows something, with the map's distances.
fn check_slice(slice: &serde_json::Value, atlas: &Atlas) {
    let step = 20.0 / 128.0;
    let submap = atlas.submaps().last().unwrap();
    let robot = (submap.t_map_submap() * submap.scans().last().unwrap().t_submap_lidar).translation;
    let range = |c: f64| ((c - 10.0) / step).ceil() as i64..=((c + 10.0) / step).floor() as i64;
    let points: Vec<[f64; 3]> = range(robot.y).flat_map(|y| range(robot.x).map(move |x| [x as f64 * step, y as f64 * step, robot.z])).collect();
    let known = points.iter().zip(in_map(atlas, &points)).filter_map(|(p, found)| Some([p[0] as f32, p[1] as f32, p[2] as f32, found?.0]));
    let known: Vec<[f32; 4]> = known.collect();
    let said: Vec<[f32; 4]> = serde_json::from_value(slice.clone()).unwrap();
    assert!(said.len() > 200 && said.len() < points.len() && said == known, "{} points of {}", said.len(), known.len());
}

#[test]
fn the_service_of_distances_answers_what_the_map_knows() {
    let Some(python) = voxelastic_testing::python("numpy, zenoh, rosbags") else { return };
    let dir = tempfile::tempdir().unwrap();
    room::write(&dir.path().join("room"), SCANS + 1);
    let times: Vec<_> = (0..=SCANS).map(|i| (if i == SCANS { 600.0 } else { 0.1 * i as f64 }, room::pose(i))).collect();
    poses::write_tum(dir.path().join("room/poses.tum"), &times).unwrap();
    let points = points();
    let bytes: Vec<u8> = points.iter().flatten().flat_map(|c| c.to_le_bytes()).collect();
    std::fs::write(dir.path().join("points.f64"), bytes).unwrap();
    for field in ["both", "tsdf"] {
        let (answer, atlas) = asked(dir.path(), &python, field);
        assert_eq!((atlas.scan_count(), &answer["success"]), (SCANS, &true.into()), "{field}");
        let (mut known, mut off, mut differ) = (0, Vec::new(), 0.0f64);
        for (k, expected) in in_map(&atlas, &points).into_iter().enumerate() {
            assert_eq!(answer["known"][k], expected.is_some(), "{field}: {:?}", points[k]);
            let Some((distance, gradient)) = expected else {
                assert!(answer["distances"][k].is_null(), "{field}: {:?}", points[k]);
                continue;
            };
            known += 1;
            let said = answer["distances"][k].as_f64().unwrap();
            differ = differ.max((said - f64::from(distance)).abs());
            (0..3).for_each(|c| differ = differ.max((answer["gradients"][k][c].as_f64().unwrap() - f64::from(gradient[c])).abs()));
            off.push((said - in_room(&points[k]).abs()).abs());
        }
        off.sort_unstable_by(f64::total_cmp);
        let [median, most] = [0.5, 0.9].map(|share| off[(off.len() as f64 * share) as usize]);
        println!("{field}: {known} of {} known, {differ:e} from the map; from the room median {median:.3} m, 90 % {most:.3} m", points.len());
        assert!(differ < 1e-6, "{field}: {differ}");
        check_slice(&answer["slice"], &atlas);
        let least = if field == "both" { points.len() / 3 } else { 100 };
        assert!(known > least && known < points.len() && median < 0.5 * VOXEL, "{field}: {known}, {median}");
    }
}
