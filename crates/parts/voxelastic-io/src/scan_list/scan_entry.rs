//! A scan with its pose, before its cloud is decoded.

use crate::points::IN_CURVATURE;
use crate::stamped_cloud::StampedCloud;
use crate::survey::e57;
use crate::{Error, Position, Result, clouds};
use std::path::{Path, PathBuf};
use voxelastic::Pose;
use voxelastic::event::NodeId;

/// A scan whose cloud has not been decoded yet. In a file of several scans (E57) it is the one numbered `index`.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct ScanEntry {
    /// The cloud's file.
    pub path: PathBuf,
    /// Position among all clouds of the dataset, 0-based.
    pub index: usize,
    /// The node of the pose graph: as the graph numbers it, else the number in the file's name, else `index`.
    pub node: NodeId,
    /// Time in seconds; `index` where the dataset has no times.
    pub time: f64,
    /// Pose of the lidar frame in the map frame.
    pub t_map_lidar: Pose,
    /// Which sensor took it, if several are mapped together: see [`Cloud::sensor`](voxelastic::Cloud::sensor).
    pub sensor: u16,
}

/// Nodes of a further sensor are numbered from here on, times its index, so that those of the first do not depend on what else is mapped.
pub(crate) const NODES_OF_SENSOR: NodeId = 1_000_000_000;

impl ScanEntry {
    /// Decodes the cloud as it is in its file.
    pub(crate) fn read(&self) -> Result<StampedCloud> {
        let mut read = read_scan(&self.path, self.index)?;
        read.cloud.sensor = self.sensor;
        Ok(read)
    }
}

/// Decodes the cloud of a file, or in an E57 file the scan numbered `index`.
pub(crate) fn read_scan(path: &Path, index: usize) -> Result<StampedCloud> {
    if clouds::CloudFormat::of(path) != Some(clouds::CloudFormat::E57) {
        return clouds::read(path);
    }
    let survey = e57::read_one(path, index)?.survey;
    if survey.offset != [0.0; 3] {
        let problem = format!("the points of scan {index} are {:?} m from the scanner", survey.offset);
        return Err(Error::content(path, Position::File, problem, "export the scans in the scanner's own frame, with their poses"));
    }
    Ok(StampedCloud::new(survey.cloud, None))
}

/// What speaks for the cloud of a file that is undistorted already, although its points have times.
pub(crate) fn undistorted_sign_of(path: &Path, index: usize) -> Option<String> {
    read_scan(path, index).is_ok_and(|read| read.times_in_curvature).then(|| IN_CURVATURE.to_owned())
}
