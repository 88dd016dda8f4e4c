//! Half a million scans in one process: whether memory and time of a scan stay as they are.
//!
//! ```sh
//! cargo run --release -p voxelastic-bench --example soak -- 500000 10 work/   # scans, rounds until a new map begins, where maps are saved
//! cargo run --release -p voxelastic-bench --example soak -- 100000            # one map of all scans
//! ```
//!
//! A row of the table for each twentieth of the scans. Times are processor times of the thread that maps, so that other programs do not count.
//!
//! A car drives round after round through the simulated street. Its poses drift by up to half a metre in a round; then a loop edge closes it, and the
//! poses of the round are corrected, so that submaps are moved, and scans are found in submaps of earlier rounds by overlap. One thread, both fields, coarse voxels and few beams:
//! what is measured is what stays behind, not what a scan costs.

#![allow(clippy::print_stdout)]

use std::error::Error;
use std::path::Path;
use voxelastic::event::{Edge, Event, NodeId, Scan};
use voxelastic::settings::{FieldKind, Settings};
use voxelastic::{Cloud, Mapper, Pose};
use voxelastic_eval::SeriesStats;
use voxelastic_io::store::{MapDetails, MapWriter};
use voxelastic_sim::{PoseSource, SimOptions, Simulation};

type Result<T> = std::result::Result<T, Box<dyn Error + Send + Sync>>;

/// Rows of the table.
const ROWS: usize = 20;
/// Drift of a whole round, metres.
const DRIFT: f64 = 0.5;
/// Seconds between two scans.
const PERIOD: f64 = 0.1;

/// The scans of a round with their true poses.
struct Round {
    clouds: Vec<Cloud>,
    poses: Vec<Pose>,
}

impl Round {
    fn simulate() -> Result<Self> {
        let options = SimOptions { sensor: "vlp-16".into(), columns: Some(128), ..SimOptions::of("street") };
        let laps = Simulation::new(options)?;
        // One round: until the car is again where it began.
        let poses = laps.poses(PoseSource::Truth);
        let start = poses[0].translation.vector;
        let away = |pose: &Pose| (pose.translation.vector - start).norm();
        let half = poses.iter().position(|pose| away(pose) > 50.0).ok_or("the street is too short")?;
        let end = (half..poses.len()).find(|&k| away(&poses[k]) < 2.0).unwrap_or(poses.len());
        let clouds: Option<Vec<Cloud>> = (0..end).map(|k| laps.cloud(k)).collect();
        Ok(Self { clouds: clouds.ok_or("a scan is missing")?, poses: poses[..end].to_vec() })
    }

    fn len(&self) -> usize {
        self.poses.len()
    }

    /// The pose of scan `k` as it is known before the round is closed: it drifts in a direction of its own for each round.
    fn drifted(&self, round: usize, k: usize) -> Pose {
        let (sin, cos) = (round as f64 * 2.4).sin_cos();
        let drift = DRIFT * k as f64 / self.len() as f64;
        Pose::translation(drift * cos, drift * sin, 0.0) * self.poses[k]
    }

    /// What comes with scan `k` of a round: the scan, the edge to it, and at the end of a round its closure and correction.
    fn events(&self, round: usize, k: usize) -> Vec<Event> {
        let node = |k: usize| (round * self.len() + k) as NodeId;
        let edge = |from, to, t_from_to| Edge { from, to, t_from_to, information: None };
        let t_map_lidar = self.drifted(round, k);
        let scan = Scan { node: node(k), time: node(k) as f64 * PERIOD, t_map_lidar, cloud: self.clouds[k].clone() };
        let mut events = vec![Event::Scan(scan)];
        if k > 0 {
            events.push(Event::OdometryEdge(edge(node(k) - 1, node(k), self.drifted(round, k - 1).inverse() * t_map_lidar)));
        } else if round > 0 {
            events.push(Event::OdometryEdge(edge(node(0) - 1, node(0), self.poses[self.len() - 1].inverse() * t_map_lidar)));
        }
        if k + 1 == self.len() {
            events.push(Event::LoopEdge(edge(k as NodeId % self.len() as NodeId, node(k), Pose::identity())));
            events.push(Event::PoseUpdate((0..self.len()).map(|k| (node(k), self.poses[k])).collect()));
        }
        // The first round closes at itself.
        events.retain(|event| !matches!(event, Event::LoopEdge(edge) if edge.from == edge.to));
        events
    }
}

/// A line of `/proc/self/status`, megabytes.
fn status_mb(key: &str) -> f64 {
    let text = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix(':'));
    line.and_then(|line| line.trim().strip_suffix("kB")?.trim().parse::<f64>().ok()).unwrap_or(f64::NAN) * 1.024e-3
}

/// What is known about the scans since the last row.
#[derive(Default)]
struct Row {
    times_ms: Vec<f64>,
    fusions: usize,
    maps: usize,
}

impl Row {
    fn print(&mut self, scans: usize, mapper: &Mapper) {
        let Self { times_ms, fusions, maps } = std::mem::take(self);
        let stats = SeriesStats::new(&times_ms);
        let [median, p95, mean] = [stats.median, stats.p95, stats.mean].map(|value| value.unwrap_or(f64::NAN));
        let most = times_ms.into_iter().fold(0.0, f64::max);
        let [rss, peak] = ["VmRSS", "VmHWM"].map(status_mb);
        let (map, submaps) = (mapper.atlas().bytes() as f64 / 1e6, mapper.atlas().submaps().len());
        println!("{scans:>8} {rss:>8.1} {peak:>8.1} {map:>8.1} {submaps:>8} {maps:>8} {fusions:>8} {median:>9.3} {mean:>9.3} {p95:>9.3} {most:>9.1}");
    }
}

/// Processor time of this thread so far, milliseconds.
fn thread_ms() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    text.split(' ').next().and_then(|nanoseconds| nanoseconds.parse::<f64>().ok()).unwrap_or(f64::NAN) * 1e-6
}

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |n: usize, default: usize| arguments.get(n).map_or(Ok(default), |text| text.parse());
    let (scans, rounds) = (number(0, 500_000)?, number(1, usize::MAX)?);
    let folder = arguments.get(2).map(Path::new);
    let round = Round::simulate()?;
    println!("{scans} scans in rounds of {}, a new map after {rounds} rounds", round.len());
    let settings = Settings { voxel_size: 0.4, max_range: 30.0, field: FieldKind::Both, sensor: "vlp-16".into(), threads: 1, ..Settings::default() };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    pool.install(|| drive(scans, rounds, folder, &round, &settings))
}

fn drive(scans: usize, rounds: usize, folder: Option<&Path>, round: &Round, settings: &Settings) -> Result<()> {
    let details = MapDetails { generator: "soak".into(), ..MapDetails::default() };
    let columns = ["scans", "rss MB", "peak MB", "map MB", "submaps", "maps", "fusions"];
    println!("{} {:>9} {:>9} {:>9} {:>9}", columns.map(|name| format!("{name:>8}")).join(" "), "median ms", "mean ms", "95 % ms", "most ms");
    let (mut mapper, mut row) = (Mapper::new(settings.clone())?, Row::default());
    for n in 0..scans {
        let before = thread_ms();
        for event in round.events(n / round.len() % rounds, n % round.len()) {
            mapper.handle(event)?;
        }
        row.times_ms.push(thread_ms() - before);
        let is_last = n + 1 == scans;
        if is_last || rounds < usize::MAX && (n + 1) % (rounds * round.len()) == 0 {
            mapper.finish();
            if let Some(folder) = folder {
                MapWriter::create(folder.join("soak.vox"))?.save(mapper.atlas(), &details)?;
            }
            row.maps += 1;
            row.fusions += mapper.elastic_counts().fusions;
            if !is_last {
                mapper = Mapper::new(settings.clone())?;
            }
        }
        if (n + 1) * ROWS / scans > n * ROWS / scans {
            row.print(n + 1, &mapper);
        }
    }
    Ok(())
}
