//! What surveyors exchange: LAS and LAZ ([`las`]), and E57 ([`e57`]), in and out; cloud-optimised LAZ ([`copc`]) out.
//!
//! Survey coordinates are often too large for single precision (UTM: millions of metres). A [`SurveyCloud`] therefore counts from an
//! offset of whole metres; [`crate::clouds::read`] gives the same points and says the offset.

pub mod copc;
pub mod e57;
mod e57_streams;
pub mod las;
mod laz;

use crate::{Error, Result};
use std::path::Path;
use voxelastic::Cloud;

/// Coordinates larger than this lose millimetres in single precision, metres.
const LARGEST_EXACT: f64 = 10_000.0;
/// A vector grows by this many points at once, whatever a header claims.
const CHUNK: usize = 1 << 16;

/// A cloud in a survey's coordinates.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SurveyCloud {
    /// What was taken off all coordinates, metres: zero, or whole numbers where they are large.
    pub offset: [f64; 3],
    /// The points; intensity as in the file.
    pub cloud: Cloud,
    /// The coordinate system, as text (WKT, OGC 01-009): LAS and COPC are written with it. Of a file that was read, that of LAS.
    pub crs_wkt: Option<String>,
}

/// Gathers points and takes the offset off them.
#[derive(Default)]
struct Gather {
    offset: Option<[f64; 3]>,
    crs_wkt: Option<String>,
    points: Vec<[f32; 3]>,
    intensity: Vec<f32>,
    colours: Vec<[u8; 3]>,
}

impl Gather {
    fn add(&mut self, p: [f64; 3]) {
        let round = |c: f64| if c.abs() > LARGEST_EXACT && c.is_finite() { (c / 1000.0).round() * 1000.0 } else { 0.0 };
        let offset = *self.offset.get_or_insert_with(|| p.map(round));
        self.points.push(std::array::from_fn(|k| (p[k] - offset[k]) as f32));
    }

    /// The cloud, with the channels that every point has.
    fn finish(self, path: &Path) -> Result<SurveyCloud> {
        let n = self.points.len();
        if !self.points.iter().any(Cloud::is_return) {
            return Err(Error::NoReturn { path: path.into(), points: n });
        }
        let intensity = Some(self.intensity).filter(|v| v.len() == n);
        let colours = Some(self.colours).filter(|c| c.len() == n);
        let cloud = Cloud { intensity, colours, ..Cloud::from_points(self.points) };
        Ok(SurveyCloud { offset: self.offset.unwrap_or_default(), cloud, crs_wkt: self.crs_wkt })
    }
}

/// Refuses channels that are not as long as the points.
fn check(path: &Path, survey: &SurveyCloud) -> Result<()> {
    let n = survey.cloud.len();
    let lengths = [("intensity", survey.cloud.intensity.as_ref().map(Vec::len)), ("colours", survey.cloud.colours.as_ref().map(Vec::len))];
    match lengths.into_iter().find(|(_, len)| len.is_some_and(|len| len != n)) {
        Some((name, len)) => Err(Error::unwritable(path, format!("{} values of {name} for {n} points", len.unwrap_or(0)))),
        None => Ok(()),
    }
}
