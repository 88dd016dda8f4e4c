//! Raw scans in, the mapper's events out.

use crate::odometry::{ImuSample, MeasuredVertical, Odometry, OdometryReport, OdometrySettings, OdometryState, Status, VERTICAL_SIGMA};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use voxelastic::event::{Edge, Event, NodeId, Scan, Vertical};
use voxelastic::{Cloud, Pose};

/// A scan without a pose.
#[derive(Clone, Debug)]
pub struct RawScan {
    /// The node that it becomes.
    pub node: NodeId,
    /// Time stamp in seconds.
    pub time: f64,
    /// The points, in the lidar frame.
    pub cloud: Cloud,
    /// Samples of an inertial measurement unit at the lidar since the scan before, up to the end of this one; empty without one.
    pub imu: Vec<ImuSample>,
}

/// What became of a scan.
#[derive(Debug)]
pub struct Step {
    /// The outcome of its registration.
    pub report: OdometryReport,
    /// What the mapper should be told, in this order; nothing if the scan is not taken.
    pub events: Vec<Event>,
}

/// Turns raw scans into the events of a registered cloud list (paper Sec. IV): scans with their poses by odometry, an odometry edge from
/// the scan before, and where up is, where an inertial unit tells.
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
}

/// What a [`Slam`] knows between two scans; see [`Slam::state`].
///
/// Its serialised form belongs to the version of the program that wrote it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SlamState {
    odometry: OdometryState,
    last: Option<Taken>,
    vertical: Option<[[f64; 3]; 2]>,
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
        Self { odometry: Odometry::new(settings), last: None, vertical: None }
    }

    /// What it knows.
    pub fn state(&self) -> SlamState {
        SlamState { odometry: self.odometry.state(), last: self.last, vertical: self.vertical }
    }

    /// One that goes on from `state`, with the settings of the one that it is of: it gives out the same events, bit for bit.
    pub fn resume(settings: OdometrySettings, state: SlamState) -> Self {
        Self { odometry: Odometry::resume(settings, state.odometry), last: state.last, vertical: state.vertical }
    }

    /// Adds a sample of an inertial measurement unit, as [`Odometry::add_imu`].
    pub fn add_imu(&mut self, sample: ImuSample) {
        self.odometry.add_imu(sample);
    }

    /// Registers a scan. If `takes` holds for its pose and it could be registered, it becomes a node.
    pub fn register(&mut self, scan: RawScan, takes: impl FnOnce(&Pose) -> bool) -> Step {
        let RawScan { node, time, mut cloud, imu } = scan;
        imu.into_iter().for_each(|sample| self.odometry.add_imu(sample));
        let report = self.odometry.register(&cloud, Some(time));
        self.vertical = report.vertical.map(|MeasuredVertical { measured, expected, .. }| [measured.into(), expected.into()]).or(self.vertical);
        if matches!(report.status, Status::Failed(_)) || !takes(&report.t_map_lidar) {
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
