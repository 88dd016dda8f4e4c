//! Worlds to test LiDAR mapping in, where the truth is known to the micrometre.
//!
//! A [`World`] is a union of convex [`solid::Solid`]s. Its signed distance is exact, and rays are cast in closed form, so that
//! a map can be measured against it with no error of the measure's own. [`scenes`] has the worlds: `campus`, `mine` and
//! `street`, and small ones for tests, each with a route through it.
//!
//! A [`Simulation`] carries a [`sensor::Lidar`] (any beam model, with noise, lost returns, mixed pixels and motion during the
//! sweep) along the route, and adds what a SLAM system would tell: odometry that drifts, loop edges where places are seen
//! again, and poses corrected when loops close. It gives [`voxelastic::event::Event`]s in memory, or writes a folder that
//! `voxelastic map` reads.
//!
//! Everything follows from [`SimOptions`] and its seed, whatever the number of threads.
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

mod bvh;
pub mod dataset;
pub mod drift;
mod error;
mod options;
pub mod picture;
pub mod random;
pub mod route;
pub mod scenes;
pub mod sensor;
mod simulation;
pub mod solid;
pub mod world;

pub use error::SimError;
pub use options::SimOptions;
pub use scenes::Scene;
pub use simulation::{PoseSource, Simulation};
pub use world::{Hit, Ray, SurfacePoint, World, WorldBuilder};
