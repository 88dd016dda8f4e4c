//! Odometry: poses of scans from the scans alone.
//!
//! A scan is moved to one time (deskew), thinned, and summed into voxels; each voxel gives a mean and, where its points are flat, a normal.
//! These are registered to a local map: voxels around the sensor on three levels, each with running statistics of its points and
//! the plane that follows from them. Distances count to planes along their normals and to other surfaces in all directions, under a robust kernel that
//! narrows. The start is a constant-velocity prediction; how far it was off lately says which levels are needed. Where the outcome fits
//! worse than usual, registrations from other headings are tried, and those that contradict the free space that the last scans saw are refused. Directions along which the surfaces do not hold the pose keep the
//! prediction and are reported. A scan that fits nowhere does not enter the map; after several of these a new piece of the trajectory begins.
//!
//! With an inertial measurement unit ([`Odometry::add_imu`]), motion during a sweep and prediction follow from its samples, whose biases are
//! estimated at rest and from the registrations. The map frame is level if gravity or the surfaces of the first scan tell how ([`Level`]).
//!
//! ```
//! use voxelastic::Cloud;
//! use voxelastic_slam::odometry::{Odometry, OdometrySettings, Status};
//!
//! // A room of 8 x 6 x 3 m, seen from `x` metres along it.
//! let room = |x: f32| {
//!     let grid = (0..6000).map(|i| ((i % 100) as f32 / 100.0, (i / 100) as f32 / 60.0));
//!     Cloud::from_points(grid.flat_map(|(u, v)| {
//!         let (a, b, c) = (8.0 * u - 4.0 - x, 6.0 * v - 3.0, 3.0 * v - 1.0);
//!         [[a, b, -1.0], [a, b, 2.0], [a, -3.0, c], [a, 3.0, c], [-4.0 - x, 6.0 * u - 3.0, c], [4.0 - x, 6.0 * u - 3.0, c]]
//!     }).collect())
//! };
//! let mut odometry = Odometry::new(OdometrySettings::default());
//! assert_eq!(odometry.register(&room(0.0), Some(0.0)).status, Status::First);
//! let report = odometry.register(&room(0.2), Some(0.1));
//! assert_eq!(report.status, Status::Tracked);
//! assert!((report.t_map_lidar.translation.x - 0.2).abs() < 0.01);
//! ```

mod alternation;
mod drift;
mod find;
mod inertial;
mod level;
mod prediction;
mod recent;
mod report;
mod settings;
mod state;
mod tracker;
mod vertical;

pub use drift::covariance_between;
pub use level::Level;
pub use report::{Failure, OdometryReport, PhaseTimes, Status};
pub use settings::OdometrySettings;
pub use state::OdometryState;
pub use tracker::Odometry;
pub use vertical::MeasuredVertical;
pub(crate) use vertical::SIGMA as VERTICAL_SIGMA;
pub use voxelastic::motion::ImuSample;
