//! A mapper that another process goes on with makes the same map, bit for bit, wherever it was stored.

use crate::store::world::{details, same_atlas};
use nalgebra::{Translation3, UnitQuaternion};
use std::error::Error;
use voxelastic::atlas::{Atlas, laps};
use voxelastic::event::{Edge, Event, NodeId, Scan};
use voxelastic::mapper::{Mapper, ScanSource};
use voxelastic::settings::{Laps, Settings};
use voxelastic::{Cloud, Pose};
use voxelastic_io::store::{Checkpoints, MapDetails, MapWriter};

const ROWS: usize = 16;
const COLUMNS: usize = 180;
/// Half of the street's length, width and height, metres.
const HALF: [f64; 3] = [40.0, 6.0, 4.0];

/// The scan of `node` in a street closed on all sides, in which a ball comes along.
fn scan(node: NodeId) -> Cloud {
    let t_map_lidar = &pose(node);
    let ball = nalgebra::Vector3::new(t_map_lidar.translation.x + 5.0 - 1.3 * (node % 9) as f64, 3.0, 0.0);
    let ray = |k: usize| {
        let (row, column) = (k / COLUMNS, k % COLUMNS);
        let elevation = (20.0 - 40.0 * row as f64 / (ROWS - 1) as f64).to_radians();
        let azimuth = std::f64::consts::TAU * column as f64 / COLUMNS as f64;
        let local = nalgebra::Vector3::new(elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin());
        let (from, direction) = (t_map_lidar.translation.vector, t_map_lidar.rotation * local);
        let wall = |k: usize| (HALF[k].copysign(direction[k]) - from[k]) / direction[k];
        let range = (0..3).map(wall).fold(f64::INFINITY, f64::min);
        let (along, square) = ((ball - from).dot(&direction), (ball - from).norm_squared());
        let inside = 1.0 - (square - along * along);
        let range = if along > 0.0 && inside > 0.0 { along - inside.sqrt() } else { range };
        (local * range).map(|c| c as f32).into()
    };
    let points: Vec<[f32; 3]> = (0..ROWS * COLUMNS).map(ray).collect();
    let intensity = Some((0..points.len()).map(|i| (i % 200) as f32).collect());
    Cloud { points, width: COLUMNS, height: ROWS, intensity, ..Cloud::default() }
}

/// Where a scan is taken: there and back again, twice.
fn pose(node: NodeId) -> Pose {
    let x = (node as f64 * 2.0 + 30.0).rem_euclid(120.0);
    let x = if x < 60.0 { x - 30.0 } else { 90.0 - x };
    Pose::from_parts(Translation3::new(x, 0.3 * (node as f64).sin(), 0.0), UnitQuaternion::from_euler_angles(0.01, 0.0, 0.1 * node as f64))
}

/// The same with the drift of an odometry.
fn drifted(node: NodeId) -> Pose {
    Pose::translation(0.0, 0.01 * node as f64, 0.0) * pose(node)
}

/// Scans by odometry, loops to those of the same place, and after each a correction of all that came.
fn events() -> Vec<Event> {
    let mut events = Vec::new();
    for node in 0..130 {
        events.push(Event::Scan(Scan { node, time: node as f64, t_map_lidar: drifted(node), cloud: scan(node) }));
        if node > 0 {
            let t_from_to = drifted(node - 1).inv_mul(&drifted(node));
            events.push(Event::OdometryEdge(Edge { from: node - 1, to: node, t_from_to, information: None }));
        }
        if node >= 60 && node % 9 == 0 {
            let from = node - 60;
            events.push(Event::LoopEdge(Edge { from, to: node, t_from_to: pose(from).inv_mul(&pose(node)), information: None }));
            events.push(Event::PoseUpdate((0..=node).map(|n| (n, pose(n))).collect()));
        }
    }
    events
}

struct Scans;

impl ScanSource for Scans {
    fn cloud(&mut self, node: NodeId) -> Result<Cloud, Box<dyn Error + Send + Sync>> {
        Ok(scan(node))
    }
}

fn settings() -> Settings {
    let mut settings = Settings { voxel_size: 0.25, max_range: 20.0, lambda_odom: 12.0, lambda_cluster: 8.0, ..Settings::default() };
    settings.set("field", "both").unwrap();
    settings.set("dynamic", "remove").unwrap();
    settings
}

fn described(settings: &Settings) -> MapDetails {
    MapDetails { settings: MapDetails::describe(settings, None).settings, ..details("resume") }
}

/// The map, with the mapper stored and taken up again after every so many events. `forget` may change what is stored.
fn mapped(settings: &Settings, events: &[Event], every: usize, forget: impl Fn(&mut serde_json::Value)) -> (Atlas, [usize; 3]) {
    let dir = tempfile::tempdir().unwrap();
    let mut mapper = Mapper::new(settings.clone()).unwrap();
    let (mut stored, mut with_fusions_due) = (0, 0);
    for (k, event) in events.iter().enumerate() {
        mapper.handle(event.clone()).unwrap();
        if (k + 1) % every != 0 {
            continue;
        }
        let Some(mut state) = mapper.state().map(|state| serde_json::to_value(&state).unwrap()) else { continue };
        with_fusions_due += usize::from(mapper.elastic_counts().fusions_due > 0);
        forget(&mut state);
        let state = serde_json::to_vec(&state).unwrap();
        let writer = MapWriter::create(dir.path().join("run.vox")).unwrap();
        Checkpoints::begin(&writer).unwrap().write(mapper.atlas(), &described(settings), &state).unwrap();
        drop(mapper);
        let (found, _) = Checkpoints::resume(&writer).unwrap().unwrap();
        let state = serde_json::from_slice(&found.state).unwrap();
        mapper = Mapper::resume(settings.clone(), None, state, found.atlas, &mut Scans).unwrap();
        stored += 1;
    }
    mapper.finish();
    let counts = mapper.elastic_counts();
    assert!(counts.moving_points > 100, "{counts:?}");
    let fusions = counts.fusions;
    (mapper.into_atlas(), [stored, with_fusions_due, fusions])
}

#[test]
fn a_stored_mapper_goes_on_as_if_nothing_had_happened() {
    let events = events();
    let (whole, [_, _, fusions]) = mapped(&settings(), &events, usize::MAX, |_| ());
    assert!(fusions > 1 && whole.submaps().len() > 2, "{fusions} fusions, {} submaps", whole.submaps().len());
    for every in [3, 40, 101] {
        let (resumed, [stored, due, _]) = mapped(&settings(), &events, every, |_| ());
        println!("every {every} events: stored {stored} times, {due} times with fusions due, {fusions} fusions");
        assert!(stored > 1 && due > 0);
        assert!(same_atlas(&whole, &resumed), "every {every} events");
    }
    // What is stored beside the fields makes a difference.
    let no_observations = |state: &mut serde_json::Value| {
        let counts = state["observed"].as_array_mut().unwrap().iter_mut().flat_map(|submap| submap[1].as_array_mut().unwrap());
        counts.for_each(|count| *count = 0.into());
    };
    let no_fusions = |state: &mut serde_json::Value| state["fusions"]["queue"] = serde_json::json!([]);
    let no_views = |state: &mut serde_json::Value| state["sensors"][0][2]["views"] = serde_json::json!([]);
    assert!(!same_atlas(&whole, &mapped(&settings(), &events, 40, no_observations).0), "observation counts");
    assert!(!same_atlas(&whole, &mapped(&settings(), &events, 40, no_views).0), "scans to find what moves");
    assert!(!same_atlas(&whole, &mapped(&settings(), &events, 40, no_fusions).0), "fusions that are due");
}

#[test]
fn a_stored_mapper_that_keeps_laps_apart_goes_on_as_if_nothing_had_happened() {
    let (settings, events) = (Settings { laps: Laps::Apart, ..settings() }, events());
    let (whole, [_, _, fusions]) = mapped(&settings, &events, usize::MAX, |_| ());
    assert!(fusions == 0 && laps(whole.submaps()).into_values().max() > Some(1));
    for every in [20, 101] {
        assert!(same_atlas(&whole, &mapped(&settings, &events, every, |_| ()).0), "every {every} events");
    }
}
