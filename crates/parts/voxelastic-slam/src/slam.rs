//! Raw scans in, the mapper's events out.

use crate::followers::{Followers, FollowingScan, TimedPose};
use crate::odometry::{ImuSample, MeasuredVertical, Odometry, OdometryReport, OdometrySettings, OdometryState, Status, VERTICAL_SIGMA};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use voxelastic::Pose;
use voxelastic::event::{Edge, Event, NodeId, Scan, Vertical};

pub use crate::raw_scan::RawScan;

/// What became of a scan.
#[derive(Debug)]
pub struct Step {
    /// The outcome of its registration.
    pub report: OdometryReport,
    /// What the mapper should be told, in this order; nothing if the scan is not taken.
    pub events: Vec<Event>,
}

/// What became of scans of further sensors.
#[derive(Debug, Default)]
pub struct Followed {
    /// What the mapper should be told, in this order.
    pub events: Vec<Event>,
    /// Nodes of the scans that have no pose: the first sensor was not registered around their times.
    pub without_pose: Vec<NodeId>,
}

/// Turns raw scans into the events of a registered cloud list (paper Sec. IV): scans with their poses by odometry, an odometry edge from
/// the scan before, and where up is, where an inertial unit tells.
///
/// Of several sensors ([`with_sensors`](Self::with_sensors)) the first is registered. The others follow it: their scans have its poses, interpolated at their own
/// times, and hang on its nodes.
///
/// ```
/// use voxelastic::Cloud;
/// use voxelastic::event::Event;
/// use voxelastic_slam::odometry::OdometrySettings;
/// use voxelastic_slam::slam::{RawScan, Slam};
///
/// // A room of 8 x 6 x 3 m, seen from `x` metres along it.
/// let room = |x: f32| {
///     let grid = (0..6000).map(|i| ((i % 100) as f32 / 100.0, (i / 100) as f32 / 60.0));
///     Cloud::from_points(grid.flat_map(|(u, v)| {
///         let (a, b, c) = (8.0 * u - 4.0 - x, 6.0 * v - 3.0, 3.0 * v - 1.0);
///         [[a, b, -1.0], [a, b, 2.0], [a, -3.0, c], [a, 3.0, c], [-4.0 - x, 6.0 * u - 3.0, c], [4.0 - x, 6.0 * u - 3.0, c]]
///     }).collect())
/// };
/// let mut slam = Slam::new(OdometrySettings::default());
/// let mut events = Vec::new();
/// for node in 0..3 {
///     let scan = RawScan { node, time: 0.1 * node as f64, cloud: room(0.2 * node as f32), imu: Vec::new() };
///     events.extend(slam.register(scan, |_| true).events);
/// }
/// assert!(matches!(events[..], [Event::Scan(_), Event::Scan(_), Event::OdometryEdge(_), Event::Scan(_), Event::OdometryEdge(_)]));
/// ```
#[derive(Debug)]
pub struct Slam {
    odometry: Odometry,
    last: Option<Taken>,
    /// Where up was measured to be since the last scan that was taken: measured and expected, map frame.
    vertical: Option<[[f64; 3]; 2]>,
    followers: Followers,
}

/// What a [`Slam`] knows between two scans; see [`Slam::state`].
///
/// Its serialised form belongs to the version of the program that wrote it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SlamState {
    odometry: OdometryState,
    last: Option<Taken>,
    vertical: Option<[[f64; 3]; 2]>,
    followed: Vec<TimedPose>,
}

/// The last scan that was taken.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Taken {
    node: NodeId,
    piece: usize,
    #[serde(with = "voxelastic::geometry::stored")]
    t_map_lidar: Pose,
}

impl Slam {
    /// One that has seen no scan.
    pub fn new(settings: OdometrySettings) -> Self {
        Self { odometry: Odometry::new(settings), last: None, vertical: None, followers: Followers::default() }
    }

    /// For several sensors: the pose of each further one in the frame of the first, in the order of [`Cloud::sensor`](voxelastic::Cloud::sensor) from 1 on.
    #[must_use]
    pub fn with_sensors(self, t_first_sensor: Vec<Pose>) -> Self {
        Self { followers: Followers::new(t_first_sensor), ..self }
    }

    /// What it knows; none while scans of further sensors wait for their poses.
    pub fn state(&self) -> Option<SlamState> {
        let followed = self.followers.state()?;
        Some(SlamState { odometry: self.odometry.state(), last: self.last, vertical: self.vertical, followed })
    }

    /// One that goes on from `state`, with the settings and the sensors of the one that it is of: it gives out the same events, bit for bit.
    pub fn resume(settings: OdometrySettings, t_first_sensor: Vec<Pose>, state: SlamState) -> Self {
        let mut followers = Followers::new(t_first_sensor);
        followers.resume(state.followed);
        Self { odometry: Odometry::resume(settings, state.odometry), last: state.last, vertical: state.vertical, followers }
    }

    /// Adds a sample of an inertial measurement unit, as [`Odometry::add_imu`].
    pub fn add_imu(&mut self, sample: ImuSample) {
        self.odometry.add_imu(sample);
    }

    /// Adds a scan of a further sensor, which waits for the pose of the first at its time. Samples of an inertial unit that come with it are used.
    pub fn follow(&mut self, mut scan: RawScan) {
        std::mem::take(&mut scan.imu).into_iter().for_each(|sample| self.odometry.add_imu(sample));
        self.followers.wait(scan);
    }

    /// The scans of further sensors that have a pose since the last scan of the first. Those become nodes for which `takes` holds, by their sensor, pose and time.
    pub fn followed(&mut self, mut takes: impl FnMut(u16, &Pose, f64) -> bool) -> Followed {
        let (due, without_pose) = self.followers.take_due();
        let mut events = Vec::new();
        for FollowingScan { scan: RawScan { node, time, cloud, .. }, t_map_lidar, piece } in due {
            if !takes(cloud.sensor, &t_map_lidar, time) {
                continue;
            }
            events.push(Event::Scan(Scan { node, time, t_map_lidar, cloud }));
            // A chain through all sensors would be longer than what was travelled.
            if let Some(last) = self.last.filter(|last| last.piece == piece) {
                let t_from_to = last.t_map_lidar.inv_mul(&t_map_lidar);
                events.push(Event::OdometryEdge(Edge { from: last.node, to: node, t_from_to, information: None }));
            }
        }
        Followed { events, without_pose }
    }

    /// After the last scan: the scans of further sensors that still wait have no pose.
    pub fn finish(&mut self) -> Followed {
        Followed { events: Vec::new(), without_pose: self.followers.finish() }
    }

    /// Registers a scan of the first sensor. If `takes` holds for its pose and it could be registered, it becomes a node.
    pub fn register(&mut self, scan: RawScan, takes: impl FnOnce(&Pose) -> bool) -> Step {
        let RawScan { node, time, mut cloud, imu } = scan;
        imu.into_iter().for_each(|sample| self.odometry.add_imu(sample));
        let report = self.odometry.register(&cloud, Some(time));
        self.vertical = report.vertical.map(|MeasuredVertical { measured, expected, .. }| [measured.into(), expected.into()]).or(self.vertical);
        let has_failed = matches!(report.status, Status::Failed(_));
        if !has_failed {
            self.followers.add_pose(time, report.piece, &report.t_map_lidar);
        }
        if has_failed || !takes(&report.t_map_lidar) {
            return Step { report, events: Vec::new() };
        }
        let t_map_lidar = report.t_map_lidar;
        cloud.motion = cloud.motion.or_else(|| report.motion.clone());
        let mut events = vec![Event::Scan(Scan { node, time, t_map_lidar, cloud })];
        let before = self.last.replace(Taken { node, piece: report.piece, t_map_lidar });
        if let Some(before) = before.filter(|before| before.piece == report.piece) {
            let t_from_to = before.t_map_lidar.inv_mul(&t_map_lidar);
            let information = Some(report.edge_information(t_from_to.translation.vector.norm()));
            events.push(Event::OdometryEdge(Edge { from: before.node, to: node, t_from_to, information }));
        }
        if let Some([measured, expected]) = self.vertical.take() {
            let up_lidar = t_map_lidar.rotation.inverse() * Vector3::from(measured);
            events.push(Event::Vertical(Vertical { node, up_lidar: up_lidar.into(), up_map: expected, sigma: VERTICAL_SIGMA }));
        }
        Step { report, events }
    }
}
