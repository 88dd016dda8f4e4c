//! The sensor (paper Sec. III): beam model, range image, returns with local planes.
//!
//! A [`BeamModel`] gives the direction of each pixel. It comes from a [`preset`], from tables, or is measured from the clouds by [`detect`], which also finds how
//! the points are laid out ([`CloudLayout`]). A [`ScanPreprocessor`] turns each cloud into a [`PreparedScan`]: the [`RangeImage`], and the [`Returns`] with a
//! local plane each, which are the input of the integrators. Where no image fits the points, planes come from the nearest points in space (`scattered`).
//!
//! A *beam* is a direction in which the sensor measures; a *return* is a measured point.

mod beam_model;
mod cloud_layout;
mod detect;
mod error;
mod normals;
mod pixel_row;
mod prepared_scan;
mod preprocess;
mod presets;
mod project;
mod range_image;
mod range_limits;
mod returns;
mod row_lookup;
mod scattered;

pub use beam_model::{BeamModel, BeamTables, Projection};
pub use cloud_layout::{CloudLayout, Grid};
pub use detect::{Detected, Fit, detect, layout_for};
pub use error::SensorError;
pub use normals::NormalSettings;
pub use prepared_scan::{Counts, PreparedScan};
pub use preprocess::{LazyScan, ScanPreprocessor};
pub use presets::{names as preset_names, preset, preset_with_columns};
pub(crate) use project::{OUTSIDE, PROJECT_CHUNK, project_chunk};
pub use range_image::{NO_POINT, RangeImage};
pub use range_limits::RangeLimits;
pub use returns::Returns;
