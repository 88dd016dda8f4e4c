//! What is asked for when a map is put on Earth.

use nalgebra::Vector3;
use std::path::PathBuf;
use voxelastic_earth::Heights;

/// Clocks of map and fixes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Clock {
    /// The same; another one is said.
    Same,
    /// The offset is found and used.
    Find,
    /// To be added to times of fixes, seconds.
    Offset(f64),
}

/// What is asked for.
#[derive(Clone, Debug)]
pub struct Request {
    /// The fixes, or control points.
    pub file: PathBuf,
    /// The topic of a recording.
    pub topic: Option<String>,
    /// What coordinates in metres are in, and what is exported is to be in: an EPSG code, or `utm`.
    pub crs: Option<String>,
    /// What heights count from, if the file does not say it.
    pub heights: Option<Heights>,
    /// Move the map as a whole only.
    pub is_rigid: bool,
    /// The antenna in the frame of the lidar, metres.
    pub lever: Vector3<f64>,
    /// Clocks.
    pub clock: Clock,
    /// Standard deviation of fixes that come without, metres.
    pub sigma: Option<f64>,
    /// For how long fixes stay off in the same direction, seconds.
    pub correlation: Option<f64>,
    /// Every how many fixes one is held out, to check the others by.
    pub check_every: Option<usize>,
}
