//! What elasticity is worth: a drive with drift and loop edges, mapped in several ways, each held against the map that the true poses
//! give. Prints a table; with `sweep`, one of `lambda_odom` x `lambda_cluster` instead.
//!
//! ```text
//! cargo run --release -p voxelastic-slam --example loops -- kitti00-loops [sweep | trace] [key=value ..]
//! ```
//! The folder must hold the odometry's trajectory, a g2o graph with loop edges, and ground truth. `trace` prints submaps and memory after
//! every 50 scans of the elastic run, and the time that each scan took. Settings as for `voxelastic map`.
#![allow(clippy::print_stdout, clippy::print_stderr)]

use std::collections::HashMap;
use std::error::Error;
use std::path::PathBuf;
use std::time::Instant;
use voxelastic::event::{Event, NodeId};
use voxelastic::mapper::{ElasticCounts, ScanSource};
use voxelastic::surface::{MeshOptions, extract};
use voxelastic::{Cloud, Mapper, Pose, Settings};
use voxelastic_eval::{PointIndex, downsample};
use voxelastic_io::{Dataset, OpenOptions, clouds, dataset};
use voxelastic_slam::graph::{LiveOptimiser, Options};

type Failure = Box<dyn Error + Send + Sync>;

/// How a map is made.
#[derive(Clone, Copy, PartialEq)]
enum Way {
    /// Every scan where the ground truth puts it.
    Truth,
    /// Where the odometry puts it.
    Odometry,
    /// The same, with loops optimised as they come.
    Elastic,
    /// The same, and all submaps rebuilt at the end.
    Rebuilt,
    /// Every scan where the last optimisation puts it, from the start.
    Batch,
}

/// A map's surface and what it took.
struct Outcome {
    surface: Vec<[f32; 3]>,
    submaps: usize,
    megabytes: f64,
    seconds: f64,
    counts: ElasticCounts,
    poses: Vec<(NodeId, Pose)>,
    /// Milliseconds of each scan, and whether a fusion was under way.
    times: Vec<(f64, bool)>,
}

struct Clouds(HashMap<NodeId, PathBuf>);

impl ScanSource for Clouds {
    fn cloud(&mut self, node: NodeId) -> Result<Cloud, Failure> {
        Ok(clouds::read(self.0.get(&node).ok_or("no such scan")?)?.cloud)
    }
}

/// Maps the drive in one way. `poses` are those of the batch.
fn map(data: &Dataset, settings: &Settings, way: Way, poses: &HashMap<NodeId, Pose>, trace: bool) -> Result<Outcome, Failure> {
    let mut mapper = Mapper::new(settings.clone())?;
    let mut live = matches!(way, Way::Elastic | Way::Rebuilt).then(|| LiveOptimiser::new(Options::default()));
    let (mut times, mut seconds) = (Vec::new(), 0.0);
    let mut take = |mapper: &mut Mapper, event: Event| -> Result<(), Failure> {
        let (is_scan, is_fusing) = (matches!(event, Event::Scan(_)), mapper.elastic_counts().fusions_due > 0);
        let clock = Instant::now();
        let outcome = mapper.handle(event);
        let took = clock.elapsed().as_secs_f64();
        seconds += took;
        if let Err(error) = outcome {
            eprintln!("{error}");
        }
        if is_scan {
            times.push((1e3 * took, is_fusing));
            if trace && times.len() % 50 == 0 {
                let counts = mapper.elastic_counts();
                let (submaps, bytes) = (mapper.atlas().submaps().len(), mapper.atlas().bytes());
                println!("scan {:5}: {submaps:3} submaps, {:7.1} MB, {} fusions", times.len(), bytes as f64 / 1e6, counts.fusions);
            }
        }
        Ok(())
    };
    for event in data.events() {
        let mut event = event?;
        if let (Way::Truth | Way::Batch, Event::Scan(scan)) = (way, &mut event) {
            scan.t_map_lidar = poses[&scan.node];
        }
        match (&mut live, event) {
            (Some(live), event) => live.handle(event)?.into_iter().try_for_each(|e| take(&mut mapper, e))?,
            // Without corrections, loops would fuse what drift has put in different places, if it is little.
            (None, Event::LoopEdge(_)) if way == Way::Odometry => {}
            (None, event) => take(&mut mapper, event)?,
        }
    }
    if let Some(event) = live.as_mut().map(LiveOptimiser::finish).transpose()?.flatten() {
        take(&mut mapper, event)?;
    }
    mapper.finish_fusions();
    if way == Way::Rebuilt {
        let mut source = Clouds(data.scans().iter().map(|s| (s.node, s.path.clone())).collect());
        for id in mapper.atlas().submaps().iter().map(|s| s.id()).collect::<Vec<_>>() {
            mapper.rebuild(id, &mut source)?;
        }
    }
    mapper.finish();
    if trace {
        println!("deformed: {:.3?}", mapper.deformed().iter().map(|d| d.distance).collect::<Vec<_>>());
        println!("{:?}", mapper.graph_counts());
    }
    let mut surface = Vec::new();
    for submap in mapper.atlas().submaps() {
        let mesh = extract(submap.tsdf(), settings.voxel_size, &MeshOptions::default());
        let points = mesh.positions.iter().map(|p| submap.t_map_submap() * nalgebra::Point3::from(p.map(f64::from)));
        surface.extend(points.map(|p| [p.x as f32, p.y as f32, p.z as f32]));
    }
    let poses = live.map_or_else(Vec::new, |live| live.poses().to_vec());
    let surface = downsample(&surface, settings.voxel_size)?;
    let (submaps, megabytes) = (mapper.atlas().submaps().len(), mapper.atlas().bytes() as f64 / 1e6);
    Ok(Outcome { surface, submaps, megabytes, seconds, counts: mapper.elastic_counts(), poses, times })
}

/// Mean and 90 % quantile of the distances of the map's surface to the true map's, metres, cut off at 20 m.
fn error(truth: &PointIndex, map: &Outcome) -> (f64, f64) {
    let mut distances: Vec<f32> = truth.distances(&map.surface, f32::INFINITY).into_iter().map(|d| d.min(20.0)).collect();
    distances.sort_by(f32::total_cmp);
    let mean = distances.iter().map(|d| f64::from(*d)).sum::<f64>() / distances.len() as f64;
    (mean, f64::from(distances[distances.len() * 9 / 10]))
}

fn row(name: &str, truth: &PointIndex, map: &Outcome) {
    let ((mean, p90), c) = (error(truth, map), &map.counts);
    let Outcome { submaps, megabytes, seconds, .. } = map;
    println!(
        "{name:24} | {mean:6.3} | {p90:6.3} | {submaps:4} | {megabytes:7.1} | {seconds:6.1} | {:4} | {:5} | {:4} | {:4} | {:5}",
        c.fusions, c.size_limited_groups, c.revisits, c.overlaps, c.submap_moves
    );
}

fn latency(map: &Outcome) {
    let quantile = |times: &mut Vec<f64>, q: f64| {
        times.sort_by(f64::total_cmp);
        times.get(((times.len().max(1) - 1) as f64 * q) as usize).copied().unwrap_or(0.0)
    };
    for (name, mut times) in [
        ("all scans", map.times.iter().map(|t| t.0).collect::<Vec<_>>()),
        ("during fusions", map.times.iter().filter(|t| t.1).map(|t| t.0).collect()),
    ] {
        let (median, p99) = (quantile(&mut times, 0.5), quantile(&mut times, 0.99));
        println!("{name}: {} scans, median {median:.2} ms, 99 % {p99:.2} ms, most {:.2} ms", times.len(), quantile(&mut times, 1.0));
    }
}

fn main() -> Result<(), Failure> {
    let mut words = std::env::args().skip(1);
    let folder = PathBuf::from(words.next().ok_or("usage: loops DATA [sweep | trace] [key=value ..]")?);
    let (mut mode, mut settings) = (String::new(), Settings { voxel_size: 0.4, max_range: 60.0, sensor: "hdl-64e".into(), ..Settings::default() });
    for word in words {
        match word.split_once('=') {
            Some((key, value)) => settings.set(key, value)?,
            None => mode = word,
        }
    }
    let open = |poses: &str| dataset::open(&folder, &OpenOptions { poses: Some(poses.into()), ..OpenOptions::default() });
    let data = open("odom")?;
    let truth: HashMap<NodeId, Pose> = open("groundtruth")?.scans().iter().map(|s| (s.node, s.t_map_lidar)).collect();
    let none = HashMap::new();
    println!("map                      |  mean  |  90 %  | subs |    MB   |    s   | fuse | apart | revi | over | moves");
    let true_map = map(&data, &settings, Way::Truth, &truth, false)?;
    let index = PointIndex::new(&true_map.surface, "the true map")?;
    row("true poses", &index, &true_map);
    if mode == "sweep" {
        for lambda_odom in [15.0, 30.0, 60.0, 120.0] {
            for share in [0.25, 0.5, 1.0] {
                let settings = Settings { lambda_odom, lambda_cluster: share * lambda_odom, ..settings.clone() };
                let outcome = map(&data, &settings, Way::Elastic, &none, false)?;
                row(&format!("{lambda_odom} m, {} m", settings.lambda_cluster), &index, &outcome);
            }
        }
        return Ok(());
    }
    row("odometry only", &index, &map(&data, &settings, Way::Odometry, &none, false)?);
    let elastic = map(&data, &settings, Way::Elastic, &none, mode == "trace")?;
    row("elastic", &index, &elastic);
    row("elastic, rebuilt", &index, &map(&data, &settings, Way::Rebuilt, &none, false)?);
    let batch: HashMap<NodeId, Pose> = elastic.poses.iter().copied().collect();
    row("optimised from the start", &index, &map(&data, &settings, Way::Batch, &batch, false)?);
    latency(&elastic);
    Ok(())
}
