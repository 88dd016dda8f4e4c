//! A map's place on Earth: coordinate systems, the fixes of receivers and control points, and where a trajectory lies among them.
//!
//! | module | contents |
//! | --- | --- |
//! | [`Geodetic`], [`LocalPlane`] | latitude, longitude and height, the frame of the Earth, the plane that touches it |
//! | [`Crs`] | projected systems by EPSG code |
//! | [`read_text`], [`Fixes`] | logs and tables of fixes; what is left out of them, and why |
//! | [`Track`] | where the sensor was at the time of a fix |
//! | [`align`] | where a map lies, as a rigid whole |
//! | [`time_offset`] | by how much the clocks of map and fixes differ |
//! | [`Georeference`] | what is stored with a map |
//! | [`written`] | a trajectory as GPX, GeoJSON and KML |
//!
//! Everything is in double precision. WGS 84, ETRS89 and ITRF are taken for one another: they differ by up to a metre.
//!
//! ```
//! use voxelastic_earth::{Crs, Geodetic, LocalPlane};
//! let place = Geodetic { latitude: 48.137154, longitude: 11.576124, height: 519.3 };
//! let [east, north, _] = "EPSG:25832".parse::<Crs>()?.of_geodetic(&place)?;
//! assert!((east - 691_650.367).abs() < 1e-3 && (north - 5_334_754.246).abs() < 1e-3);
//! assert!(LocalPlane::at(place).of_geodetic(&place).norm() < 1e-8);
//! # Ok::<(), voxelastic_earth::EarthError>(())
//! ```

mod align;
mod crs;
mod error;
mod fix;
mod geodetic;
mod georeference;
mod offset;
mod read;
#[cfg(test)]
mod test_values;
mod track;
pub mod written;

pub use align::{Alignment, Pair, align};
pub use crs::Crs;
pub use error::EarthError;
pub use fix::{Finding, Fix, Fixes, Heights, Place, covariance_of};
pub use geodetic::{Geodetic, LocalPlane};
pub use georeference::{Georeference, Projector};
pub use offset::{TimeOffset, time_offset};
pub use read::{LEAP_SECONDS, read_sentences, read_text};
pub use track::{Moment, Track};
