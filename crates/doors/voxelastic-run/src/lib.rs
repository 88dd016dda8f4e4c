//! Runs of the mapper, behind every door: the command, Python, a live node and a fleet's tasks are arguments, arrays and topics around the same
//! [`MappingRun`].
//!
//! ```text
//! source    a folder or a recording is pulled (`source`), or inputs are pushed: [`Input`]
//! poses     given, by odometry, or found in a map of before (`poses`); the origin of the map is taken off
//! edit      edits of a saved map by hand, which can be undone (`editing`)
//! correct   loop closures and optimisation (`corrections`); sessions are joined to a saved map (`joining`)
//! map       the mapper with its threads and its log (`mapping`, `log`)
//! keep      checkpoints, journal, the map on disk (`keep`)
//! tell      warnings with stable codes (`warning`), the log of the run, observers of what happens
//! ```
//!
//! ```
//! use voxelastic::event::{Event, Scan};
//! use voxelastic::{Cloud, Pose, Settings};
//! use voxelastic_run::keep::Comes;
//! use voxelastic_run::poses::Poses;
//! use voxelastic_run::{Corrections, Input, MappingRun, Plan, threads};
//!
//! let settings = Settings { sensor: "vlp-16".to_owned(), ..Settings::default() };
//! let plan = Plan { settings, corrections: Corrections::default(), poses: Poses::Given, sensor: None, comes: Comes::InOrder };
//! let mut run = MappingRun::new(plan, threads::pool(1)?)?;
//! let cloud = Cloud::from_points((0..50).map(|i| [2.0, 0.01 * i as f32, 0.0]).collect());
//! // UTM coordinates: the map gets an origin near its first pose.
//! let scan = Scan { node: 0, time: 0.0, t_map_lidar: Pose::translation(448_000.0, 5_411_000.0, 100.0), cloud };
//! let taken = run.take(Input::Event(Event::Scan(scan)), &mut ());
//! assert_eq!((taken.integrated.len(), taken.refused.len()), (1, 0));
//! assert_eq!(run.origin().coordinates(), [448_000.0, 5_411_000.0, 0.0]);
//! # Ok::<(), voxelastic_run::Error>(())
//! ```

pub mod corrections;
pub mod editing;
pub mod error;
pub mod export;
pub mod georeference;
mod input;
pub mod joining;
pub mod keep;
mod kept_scans;
mod log;
pub mod map_files;
pub mod mapping;
pub mod painting;
pub mod poses;
pub mod precision;
pub mod refining;
mod run;
pub mod source;
pub mod surfaces;
pub mod threads;
pub mod usage;
mod warning;

pub use corrections::Corrections;
pub use error::{During, Error, Result};
pub use input::Input;
pub use kept_scans::KeptScans;
pub use mapping::Mapping;
pub use run::{Bent, MappingRun, Moment, Observer, Plan, SavedMap, SavedSession, Taken};
pub use source::{HoldOut, Inputs, PosesCheck, Source};
pub use voxelastic_report::Warning;
pub use warning::{Code, Warnings};
