//! Simulated worlds with exact distances, and a simulated LiDAR and SLAM system, to test LiDAR mapping.
//!
//! A [`World`] is a union of convex [`solid::Solid`]s. Its signed distance is exact and rays are intersected in closed form, so maps can be evaluated
//! without errors of the reference. [`scenes`] contains the worlds `campus`, `mine`, `street` and `tunnel`, and small ones for tests, each with a
//! trajectory through it; [`WorldBuilder`] makes others.
//!
//! A [`Simulation`] moves a [`sensor::Lidar`] (any beam model, with noise, lost returns, mixed pixels and motion during the sweep) along the trajectory
//! and adds the output of a SLAM system ([`drift`]): drifting odometry, loop edges, and corrected poses at loop closures. It yields
//! [`voxelastic::event::Event`]s in memory, or writes a folder that `voxelastic map` reads ([`dataset`]), or a ROS 2 recording in such a folder.
//! A [`camera`] may be beside the sensor: the colours of worlds are known, too.
//! Cars and walkers may move through the world meanwhile ([`traffic`]), and an inertial measurement unit ([`imu`]) beside the sensor.
//!
//! Everything is determined by [`SimOptions`] and its seed, for any number of threads.
//!
//! ```
//! use voxelastic_sim::{PoseSource, SimOptions, Simulation};
//!
//! let simulation = Simulation::new(SimOptions { scans: Some(2), columns: Some(128), ..SimOptions::of("room") })?;
//! for scan in simulation.scans(PoseSource::Truth) {
//!     let rigid = voxelastic::geometry::Rigid::from(&scan.t_map_lidar);
//!     let p = rigid.apply(scan.cloud.points[1000]);
//!     let error = simulation.world().distance(p.map(f64::from));
//!     assert!(error.abs() < 0.1, "a few sigma of range noise");
//! }
//! # Ok::<(), voxelastic_sim::SimError>(())
//! ```

pub mod camera;
pub mod dataset;
pub mod drift;
mod error;
pub mod imu;
mod options;
pub mod picture;
pub mod random;
mod reachable;
mod recording;
pub mod route;
pub mod scenes;
pub mod sensor;
mod simulation;
pub mod solid;
mod solid_bvh;
pub mod traffic;
pub mod world;

pub use error::SimError;
pub use options::{SecondLidar, SimOptions};
pub use reachable::ReachableSpace;
pub use scenes::Scene;
pub use simulation::{PoseSource, Simulation};
pub use world::{Hit, Ray, SurfacePoint, World, WorldBuilder};
