//! How fast is it, how much memory does it take, and what is the map worth that comes out?
//!
//! Everything is measured as users would run it: each configuration is a `voxelastic map` of its own, a process whose peak of memory is its
//! own, and the map that it leaves is measured with `voxelastic eval` and `voxelastic heldout`. [`Workshop`] starts these processes.
//!
//! | question | room |
//! | --- | --- |
//! | Time, memory and error at the paper's settings, with peers on the same scans | [`suite`] |
//! | What was aimed at, and what was reached? | [`goals`] |
//! | How does another mapping system take part? | [`peers`] |
//! | Do corrections and second visits stay cheap? | [`elastic`] |
//! | How does cost grow with the sensor, the range, the voxels, the map? | [`growth`] |
//!
//! Results are plain data that serialise to JSON with keys that stay ([`suite::Suite`], [`growth::Growth`]); [`table`] and [`plots`] show them.

mod data;
pub mod elastic;
mod error;
mod figures;
pub mod goals;
pub mod growth;
pub mod peers;
pub mod plots;
mod process;
mod quality;
pub mod run;
mod setting;
pub mod suite;
pub mod table;
mod workshop;

pub use data::{Dataset, Truth};
pub use error::{BenchError, Result};
pub use quality::Quality;
pub use setting::{FIELDS, HARD, SETTINGS, Setting};
pub use voxelastic_eval::Spread;
pub use workshop::Workshop;
