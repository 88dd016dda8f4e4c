//! Which field of a point record holds what, by the names that drivers and LIO systems use.

use super::colours::ColourFields;
use super::record::Field;
use crate::{Error, Position, Result};
use std::path::Path;

/// Names of return strength, the first that is present wins. `scalar_*` is CloudCompare's.
const INTENSITY: [&str; 7] = ["intensity", "reflectivity", "scalar_intensity", "i", "remission", "reflectance", "scalar_reflectivity"];
/// Names of the ring.
const RING: [&str; 8] = ["ring", "channel", "line", "laser_id", "laser", "row", "beam", "scalar_ring"];
/// Names of the time of a point: Ouster `t`, Velodyne `time`, Livox `offset_time`, Hesai and RoboSense `timestamp`.
/// FAST-LIO stores milliseconds in `curvature`, which holds the curvature of the surface elsewhere: last.
const TIME: [&str; 8] = ["t", "time", "offset_time", "timestamp", "time_offset", "time_stamp", "scalar_time", CURVATURE];
/// The field that FAST-LIO stores times in.
pub(super) const CURVATURE: &str = "curvature";

/// Whether a field of this name holds the times of points.
pub(crate) fn is_time(name: &str) -> bool {
    TIME.iter().any(|t| name.eq_ignore_ascii_case(t)) || is_about_time(name)
}

/// Speaks for clouds that are undistorted already.
pub(crate) const IN_CURVATURE: &str = "times of points are in the field curvature, where an odometry keeps them";
/// Words in the names of topics whose clouds an odometry has undistorted.
const UNDISTORTED: [&str; 4] = ["registered", "deskew", "undistort", "compensated"];

/// What speaks for clouds that are undistorted already, although their points have times: the topic's name, or the field that the times are in.
pub(crate) fn undistorted_sign(topic: &str, fields: &[String]) -> Option<String> {
    let mut times = fields.iter().filter(|name| is_time(name)).peekable();
    times.peek()?;
    let lower = topic.to_ascii_lowercase();
    if UNDISTORTED.iter().any(|word| lower.contains(word)) {
        return Some(format!("the topic is called {topic}"));
    }
    times.all(|name| name.eq_ignore_ascii_case(CURVATURE)).then(|| IN_CURVATURE.to_owned())
}

fn is_about_time(name: &str) -> bool {
    let name = name.to_ascii_lowercase();
    ["time", "stamp"].iter().any(|word| name.contains(word)) || ["ts", "dt", "t_offset", "offset_t"].contains(&name.as_str())
}

/// The fields that are used, as indices into the record's fields.
#[derive(Clone, Debug)]
pub(crate) struct FieldRoles {
    pub(crate) xyz: [usize; 3],
    pub(crate) intensity: Option<usize>,
    pub(crate) ring: Option<usize>,
    pub(crate) time: Option<usize>,
    pub(crate) colour: Option<ColourFields>,
}

impl FieldRoles {
    /// Finds the fields by name, regardless of case.
    pub(crate) fn of(fields: &[Field], path: &Path) -> Result<Self> {
        let find = |name: &str| fields.iter().position(|f| f.count == 1 && f.name.eq_ignore_ascii_case(name));
        let first = |names: &[&str]| names.iter().find_map(|n| find(n));
        let coordinate = |name: &str| {
            let at = || Position::Field(name.into());
            let k = fields.iter().position(|f| f.name.eq_ignore_ascii_case(name)).ok_or_else(|| {
                let present: Vec<&str> = fields.iter().map(|f| f.name.as_str()).collect();
                Error::content(
                    path,
                    at(),
                    format!("missing among the fields {}", present.join(" ")),
                    "a cloud needs the fields x, y and z, in metres",
                )
            })?;
            let field = &fields[k];
            if field.scalar.is_float() && field.count == 1 {
                return Ok(k);
            }
            let what = if field.count == 1 { field.scalar.name().to_owned() } else { format!("{} numbers", field.count) };
            Err(Error::content(path, at(), format!("is {what}"), "coordinates must be 32-bit or 64-bit floats, in metres"))
        };
        let xyz = [coordinate("x")?, coordinate("y")?, coordinate("z")?];
        let colour = ColourFields::of(fields, find);
        // Drivers put words around it: `point_time_offset`, `stamps`, `timestamp_ns`.
        let named_time = || fields.iter().position(|f| f.count == 1 && is_about_time(&f.name) && f.scalar.size() >= 4);
        let known_time = first(&TIME[..TIME.len() - 1]).or_else(named_time).or_else(|| find(CURVATURE));
        Ok(Self { xyz, intensity: first(&INTENSITY), ring: first(&RING), time: known_time, colour })
    }

    /// The fields that are used.
    pub(crate) fn fields<'a>(&self, fields: &'a [Field]) -> Vec<&'a Field> {
        let colour = self.colour.into_iter().flat_map(ColourFields::indices);
        self.xyz.iter().copied().chain(self.intensity).chain(self.ring).chain(self.time).chain(colour).map(|k| &fields[k]).collect()
    }
}
