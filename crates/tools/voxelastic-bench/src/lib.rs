//! Benchmarks of Voxelastic: speed, memory and accuracy, compared with other mapping systems.
//!
//! Everything is measured as users would run it. Each configuration is a `voxelastic map` of its own process, so that peak memory is its own, and the map
//! is evaluated with `voxelastic eval` or `voxelastic heldout`. A [`Workspace`] holds the program under test and a working folder.
//!
//! The data flow: [`suite::run`] or [`growth::run`] starts processes and collects [`run::Run`]s (times and memory per scan from the run's log,
//! [`Quality`] from its evaluation); [`suite::Suite`] and [`growth::Growth`] serialise to JSON with stable keys; [`table`] and [`plots`] show them.
//!
//! | question | module |
//! | --- | --- |
//! | Time, memory and accuracy at the paper's settings, with peers on the same scans | [`suite`] |
//! | Are the goals of the project reached? | [`goal`] |
//! | How is another mapping system measured? | [`peers`] |
//! | What do pose updates, second laps and mesh extraction cost? | [`special`] |
//! | How good are odometry and loop closures from the scans alone? | [`slam`] |
//! | Everything that pip can install beside ours, as one page | [`comparison`] |
//! | How do costs grow with the sensor, the range, the voxels, the map? | [`growth`] |
//!
//! ```
//! use voxelastic_bench::{Peer, SeriesStats, table};
//! use voxelastic_bench::run::Run;
//! use voxelastic_bench::suite::Suite;
//! // Results are plain data. `suite::run` makes them; here is a run of a peer that was stopped early.
//! let peer = Peer::parse("OctoMap=python3 octomap_adapter.py").unwrap();
//! let times = [40.0, 44.0, 41.0];
//! let run = Run { system: peer.name, scans: 3, scans_offered: 210, cpu_ms: SeriesStats::new(&times), ..Run::default() };
//! let text = table::suite(&Suite { runs: vec![run], ..Suite::default() });
//! assert!(text.contains("OctoMap") && text.contains("3 of 210"));
//! ```

pub mod comparison;
mod data;
mod error;
pub mod goal;
mod goals;
pub mod growth;
pub mod peers;
pub mod plots;
mod process;
mod quality;
mod results;
pub mod run;
mod setting;
pub mod slam;
pub mod special;
pub mod suite;
pub mod table;
mod workspace;

pub use data::{Dataset, Truth};
pub use error::{BenchError, Result};
pub use peers::Peer;
pub use quality::Quality;
pub use setting::{FIELDS, HARDEST, SETTINGS, Setting};
pub use voxelastic_eval::SeriesStats;
pub use workspace::Workspace;
