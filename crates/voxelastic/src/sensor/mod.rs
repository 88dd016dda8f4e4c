//! The sensor (paper Sec. III): beam model, range image, normals, pyramid.
//!
//! A [`BeamModel`] says which pixel looks where. It comes from a [`preset`], from tables, or is measured from the clouds
//! themselves by [`detect`], which also finds how the points are laid out ([`Layout`]). A [`Preparer`] turns each cloud into a
//! [`PreparedScan`]: the [`RangeImage`], and the [`Beams`] with a local plane for each return, which is what the integrators
//! take. A [`Pyramid`] over the image answers what a box of pixels sees in a constant number of steps.

mod assign;
mod detect;
mod error;
mod image;
mod layout;
pub mod model;
mod normals;
mod prepare;
mod presets;
mod pyramid;
mod rows;
mod trig;

pub use detect::{Detected, Fit, detect, layout_for};
pub use error::SensorError;
pub use image::{NO_POINT, RangeImage};
pub use layout::{Grid, Layout};
pub use model::{BeamModel, BeamTables, Projection};
pub use normals::NormalSettings;
pub use prepare::{Beams, Counts, Limits, PreparedScan, Preparer};
pub use presets::{names as preset_names, preset, preset_with_columns};
pub use pyramid::{Coverage, Pyramid, View};
pub use trig::atan2;
pub(crate) use trig::{larger, smaller};
