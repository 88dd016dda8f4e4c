//! Statistics of distances, errors and series.
//!
//! | type | for |
//! | --- | --- |
//! | [`DistanceStats`] | distances that may be cut off (infinite): percentiles, shares below a limit, a histogram |
//! | [`ErrorStats`] | trajectory errors, all finite: what `evo` reports |
//! | [`SeriesStats`] | times and memory per scan: median, 95th percentile, mean |
//!
//! Sums run in a fixed order, so results do not depend on the number of threads.

mod distances;
mod errors;
mod quantile;
mod series;

pub use distances::{DistanceStats, Histogram, fraction_under};
pub use errors::ErrorStats;
pub use series::{SeriesStats, last_over_first, mean};
