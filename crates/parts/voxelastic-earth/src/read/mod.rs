//! Reading fixes from text: logs of receivers (NMEA), solutions of RTKLIB (`.pos`), and tables of times or names with coordinates.

mod leap;
mod nmea_log;
mod pos;
mod table;

pub use leap::LEAP_SECONDS;
pub use nmea_log::read_sentences;

use crate::{EarthError, Fixes};

/// Reads fixes, or control points, from the text of a file; its form is recognised.
///
/// ```
/// let text = "time,latitude,longitude,height,sigma\n10.0,48.1,11.5,520.0,0.02\n11.0,48.10001,11.5,520.0,0.02\n";
/// let fixes = voxelastic_earth::read_text(text).unwrap();
/// assert_eq!((fixes.all.len(), fixes.all[1].time), (2, Some(11.0)));
/// ```
///
/// # Errors
/// A form that is not known, and the line of a number that is missing or none.
pub fn read_text(text: &str) -> Result<Fixes, EarthError> {
    let first = text.lines().map(str::trim).find(|line| !line.is_empty()).unwrap_or_default();
    if first.starts_with(['$', '!']) || text.lines().take(50).filter(|line| line.contains("$G")).count() > 2 {
        Ok(nmea_log::read(text))
    } else if first.starts_with('%') || text.lines().take(40).any(|line| line.starts_with('%') && line.contains("latitude(deg)")) {
        pos::read(text)
    } else {
        table::read(text)
    }
}
