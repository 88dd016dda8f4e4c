//! A simulation: scans along a trajectory, true and drifting poses, loop edges, corrections.

mod probes;

use crate::drift::{self, Correction};
use crate::imu::Imu;
use crate::options::SimOptions;
use crate::random::Stream;
use crate::sensor::{Lidar, LidarSettings, Pattern, thin};
use crate::traffic::{Surroundings, Traffic};
use crate::{Scene, SimError, SurfacePoint, World};
use hashbrown::HashSet;
use rayon::prelude::*;
use voxelastic::event::{Edge, Event, NodeId, Scan};
use voxelastic::motion::ImuSample;
use voxelastic::sensor::{preset, preset_with_columns};
use voxelastic::{Cloud, Pose};

/// Which poses the scans have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PoseSource {
    /// The true poses.
    Truth,
    /// The poses of the drifting odometry.
    Odometry,
    /// The poses that a SLAM system has when the scan is taken: odometry since the last correction.
    Online,
}

/// The second sensor.
#[derive(Clone, Debug)]
struct Second {
    lidar: Lidar,
    t_lidar_second: Pose,
    /// Its sweeps begin so much later than those of the first, seconds.
    delay: f64,
    noise: Stream,
}

/// A simulation. Poses and edges are computed at construction; scans on demand, in any order.
///
/// The map frame is the world frame: with true poses, [`World::distance`] applies to the map directly.
#[derive(Clone, Debug)]
pub struct Simulation {
    options: SimOptions,
    scene: Scene,
    lidar: Lidar,
    second: Option<Second>,
    times: Vec<f64>,
    truth: Vec<Pose>,
    odometry: Vec<Pose>,
    online: Vec<Pose>,
    odometry_edges: Vec<Edge>,
    loop_edges: Vec<Edge>,
    corrections: Vec<Correction>,
    noise: Stream,
    traffic: Traffic,
    imu: Option<(Imu, Stream)>,
}

impl Simulation {
    /// Builds the world, the poses and the edges.
    ///
    /// # Errors
    /// Unknown worlds or sensors, settings out of range.
    pub fn new(options: SimOptions) -> Result<Self, SimError> {
        options.check()?;
        let scene = options.scene()?;
        let lidar = lidar(&options.sensor, options.columns, options.lidar)?;
        let step = step(&options, &scene);
        let times: Vec<f64> = (0..options.scans.unwrap_or(scene.default_scans)).map(|k| k as f64 * step).collect();
        let truth: Vec<Pose> = times.iter().map(|&t| scene.trajectory.pose(t)).collect();
        let random = |purpose| Stream::new(options.seed, &[0xd1, purpose]);
        let odometry = drift::drifting_odometry(&truth, options.drift, &random(0));
        let loop_edges = drift::find_loops(&scene.world, &truth, &options.loops, &random(1));
        let corrections = drift::corrections(&truth, &loop_edges, &random(2));
        let online = online(&odometry, &corrections);
        let odometry_edges = drift::odometry_edges(&odometry, options.drift);
        let noise = random(3);
        let second = match &options.second {
            Some(second) => Some(Second {
                lidar: self::lidar(&second.sensor, second.columns, options.lidar)?,
                t_lidar_second: second.t_lidar_second(),
                // Two sensors that turn by themselves are not in step.
                delay: if options.lidar.moving { 0.5 * options.lidar.period } else { 0.0 },
                noise: random(5),
            }),
            None => None,
        };
        let imu = options.imu.map(|settings| (Imu::new(settings), random(4)));
        let traffic = Traffic::along(&scene, options.traffic, options.seed)?;
        Ok(Self { options, scene, lidar, second, times, truth, odometry, online, odometry_edges, loop_edges, corrections, noise, traffic, imu })
    }

    /// The options it was made from.
    pub fn options(&self) -> &SimOptions {
        &self.options
    }

    /// The world.
    pub fn world(&self) -> &World {
        &self.scene.world
    }

    /// The world and the trajectory.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The sensor.
    pub fn lidar(&self) -> &Lidar {
        &self.lidar
    }

    /// Number of scans and nodes; nodes are numbered from 0.
    pub fn len(&self) -> usize {
        self.times.len()
    }

    /// Whether there is no scan; always false.
    pub fn is_empty(&self) -> bool {
        self.times.is_empty()
    }

    /// Seconds from one scan to the next.
    pub(crate) fn step(&self) -> f64 {
        step(&self.options, &self.scene)
    }

    /// Start time of each node's sweep, seconds.
    pub fn times(&self) -> &[f64] {
        &self.times
    }

    /// True pose of the lidar frame in the map frame at each node's time.
    pub fn ground_truth(&self) -> &[Pose] {
        &self.truth
    }

    /// Poses of the drifting odometry; the first is the true one.
    pub fn odometry(&self) -> &[Pose] {
        &self.odometry
    }

    /// Edges between consecutive nodes, as measured by the odometry.
    pub fn odometry_edges(&self) -> &[Edge] {
        &self.odometry_edges
    }

    /// Loop edges in the order in which they close.
    pub fn loop_edges(&self) -> &[Edge] {
        &self.loop_edges
    }

    /// Corrected poses after each loop edge, see [`Correction`].
    pub fn corrections(&self) -> &[Correction] {
        &self.corrections
    }

    /// The poses of all nodes from a source.
    pub fn poses(&self, source: PoseSource) -> &[Pose] {
        match source {
            PoseSource::Truth => &self.truth,
            PoseSource::Odometry => &self.odometry,
            PoseSource::Online => &self.online,
        }
    }

    /// The cloud of node `k`, lidar frame; `None` beyond the last. Deterministic for any number of threads.
    pub fn cloud(&self, k: usize) -> Option<Cloud> {
        self.labelled_cloud(k).map(|(cloud, _)| cloud)
    }

    /// As [`cloud`](Self::cloud), with the [`Label`](crate::traffic::Label) of each point, as a number. Where clouds are thinned, a cube with points of several
    /// labels has the largest.
    pub fn labelled_cloud(&self, k: usize) -> Option<(Cloud, Vec<u8>)> {
        let time = *self.times.get(k)?;
        let trajectory = &self.scene.trajectory;
        let world = self.traffic.within(&self.scene.world, time);
        let (cloud, mut labels) = self.lidar.labelled_scan(world, |offset| trajectory.pose(time + offset), &self.noise.fork(k as u64));
        let cloud = match self.options.thin {
            Some(cell) => thin(&cloud, &mut labels, cell),
            None => cloud,
        };
        Some((cloud, labels))
    }

    /// Pose of the second sensor in the frame of the first, if there is one.
    pub fn t_lidar_second(&self) -> Option<Pose> {
        self.second.as_ref().map(|second| second.t_lidar_second)
    }

    /// Start time of the second sensor's sweep and its cloud at node `k`, in its own frame; `None` beyond the last, or without such a sensor.
    pub fn second_cloud(&self, k: usize) -> Option<(f64, Cloud)> {
        let Second { lidar, t_lidar_second, delay, noise } = self.second.as_ref()?;
        let time = *self.times.get(k)? + delay;
        let trajectory = &self.scene.trajectory;
        let world = self.traffic.within(&self.scene.world, time);
        let (cloud, mut labels) = lidar.labelled_scan(world, |offset| trajectory.pose(time + offset) * t_lidar_second, &noise.fork(k as u64));
        Some((time, self.options.thin.map_or_else(|| cloud.clone(), |cell| thin(&cloud, &mut labels, cell))))
    }

    /// The inertial measurement unit, if there is one.
    pub fn imu_unit(&self) -> Option<&Imu> {
        self.imu.as_ref().map(|(imu, _)| imu)
    }

    /// Its samples from the beginning to the end of the last sweep, in the frame of the unit; none without a unit.
    pub fn imu(&self) -> Vec<ImuSample> {
        let (Some((imu, random)), Some(last)) = (&self.imu, self.times.last()) else { return Vec::new() };
        imu.samples(last + self.lidar.settings().period, |t| self.scene.trajectory.pose(t), random)
    }

    /// The scan of node `k` with its pose from `source`; `None` beyond the last.
    pub fn scan(&self, k: usize, source: PoseSource) -> Option<Scan> {
        let cloud = self.cloud(k)?;
        Some(Scan { node: k as NodeId, time: self.times[k], t_map_lidar: self.poses(source)[k], cloud })
    }

    /// All scans in order, computed on demand.
    pub fn scans(&self, source: PoseSource) -> impl Iterator<Item = Scan> + '_ {
        (0..self.len()).filter_map(move |k| self.scan(k, source))
    }

    /// The events of an online SLAM system in order: each scan with its [`PoseSource::Online`] pose, the odometry edge to it, and at a loop closure the loop
    /// edge and the corrected poses of all nodes so far.
    pub fn events(&self) -> impl Iterator<Item = Event> + '_ {
        (0..self.len()).flat_map(move |k| {
            let scan = self.scan(k, PoseSource::Online).map(Event::Scan);
            let edge = k.checked_sub(1).map(|before| Event::OdometryEdge(self.odometry_edges[before].clone()));
            let closing = self.loop_edges.binary_search_by_key(&(k as NodeId), |e| e.to).ok();
            let closed = closing.map(|at| [Event::LoopEdge(self.loop_edges[at].clone()), self.update(at)]);
            scan.into_iter().chain(edge).chain(closed.into_iter().flatten())
        })
    }

    fn update(&self, closing: usize) -> Event {
        Event::PoseUpdate((0..).zip(self.corrections[closing].poses.iter().copied()).collect())
    }

    /// The true surface visible to the sensor, or the two, within `max_range` metres: the points hit by noiseless beams of all scans, downsampled to one point per cube of
    /// `spacing` metres, in the order of the scans. It is the reference of completeness.
    pub fn visible_surface(&self, spacing: f64, max_range: f64) -> Vec<SurfacePoint> {
        let spacing = spacing.max(1e-3);
        let mut occupied: HashSet<[i32; 3]> = HashSet::new();
        let mut surface = Vec::new();
        let sensors = std::iter::once((&self.lidar, Pose::identity(), 0.0));
        let sensors: Vec<_> = sensors.chain(self.second.as_ref().map(|s| (&s.lidar, s.t_lidar_second, s.delay))).collect();
        let sweeps = self.times.iter().flat_map(|time| sensors.iter().map(move |(lidar, mounting, delay)| (*lidar, mounting, time + delay)));
        for (lidar, mounting, time) in sweeps {
            let rows = lidar.model().rows();
            let pose_at = |offset| self.scene.trajectory.pose(time + offset) * mounting;
            let around = Surroundings { time, ..Surroundings::from(&self.scene.world) };
            let columns = lidar.true_points(&around, pose_at, max_range);
            // Neighbours in a column often share a cube: drop them before the lookup in the set.
            let downsampled: Vec<Vec<([i32; 3], SurfacePoint)>> = columns
                .par_chunks(rows)
                .map(|column| {
                    let mut kept: Vec<([i32; 3], SurfacePoint)> = Vec::new();
                    for point in column.iter().flatten() {
                        let key = point.point.map(|c| (c / spacing).floor() as i32);
                        if kept.last().is_none_or(|(last, _)| *last != key) {
                            kept.push((key, *point));
                        }
                    }
                    kept
                })
                .collect();
            surface.extend(downsampled.into_iter().flatten().filter(|(key, _)| occupied.insert(*key)).map(|(_, point)| point));
        }
        surface
    }
}

/// Seconds from one scan to the next.
fn step(options: &SimOptions, scene: &Scene) -> f64 {
    options.rate.map_or(options.spacing / scene.trajectory.carrier.speed, |rate| 1.0 / rate)
}

/// A sensor by its name.
fn lidar(name: &str, columns: Option<usize>, settings: LidarSettings) -> Result<Lidar, SimError> {
    match (Pattern::named(name), columns) {
        (Some(pattern), _) => Lidar::of_pattern(pattern, settings),
        (None, Some(columns)) => Lidar::new(preset_with_columns(name, columns)?, settings),
        (None, None) => Lidar::new(preset(name)?, settings),
    }
}

/// The poses available online at each scan: odometry since the last corrected node.
fn online(odometry: &[Pose], corrections: &[Correction]) -> Vec<Pose> {
    let mut next = 0;
    let mut shift = Pose::identity();
    odometry
        .iter()
        .enumerate()
        .map(|(k, pose)| {
            // A correction is available from the node after the one that closed the loop.
            while let Some(done) = corrections.get(next).filter(|c| (c.node as usize) < k) {
                let node = done.node as usize;
                shift = done.poses.last().map_or(shift, |corrected| corrected * odometry[node].inverse());
                next += 1;
            }
            shift * pose
        })
        .collect()
}

#[cfg(test)]
mod tests;
