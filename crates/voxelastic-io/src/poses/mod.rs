//! Trajectories as text files: TUM, KITTI rows, Newer College CSV; LIO-SAM's key poses; and lists of times.

mod kitti;
mod lio_sam;
mod newer_college;
mod sniff;
mod times;
mod tum;
mod write;

pub use sniff::PoseFormat;
pub(crate) use sniff::{Kind, sniff};
pub use times::{parse_times, read_times};
pub use write::{write_kitti, write_tum};

use crate::{Error, Result, file, g2o, text};
use std::path::Path;
use voxelastic::Pose;
use voxelastic::event::NodeId;

/// Poses in the order of their file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trajectory {
    /// Poses in the map frame. Of which frame (lidar or base) the file does not say.
    pub poses: Vec<Pose>,
    /// Time of each pose in seconds, increasing, if the format has times.
    pub times: Option<Vec<f64>>,
    /// Identifier of each pose's node, ascending, if the poses came from a pose graph.
    pub nodes: Option<Vec<NodeId>>,
}

impl Trajectory {
    /// Number of poses.
    pub fn len(&self) -> usize {
        self.poses.len()
    }

    /// Whether there is no pose.
    pub fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }
}

/// Reads a trajectory of any format that this crate knows, recognised by its content; a `.pcd` is LIO-SAM's `transformations.pcd`.
///
/// # Errors
/// [`Error::Content`], naming line and field, if the content is of no known format, a number is none or not finite, a
/// quaternion's length or a matrix is off by more than 0.01, or times do not increase; [`Error::Io`].
pub fn read(path: impl AsRef<Path>) -> Result<Trajectory> {
    let path = path.as_ref();
    if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("pcd")) {
        return lio_sam::parse(&file::read(path)?, path);
    }
    let text = text::read(path)?;
    match sniff(&text) {
        Some(Kind::Poses(format)) => parse(&text, path, format),
        _ => Err(Error::content(
            path,
            crate::Position::line(1),
            "not a trajectory that is known",
            "use TUM (time x y z qx qy qz qw), KITTI rows of 12 numbers, sec,nsec,x,y,z,qx,qy,qz,qw, or g2o",
        )),
    }
}

/// Decodes a trajectory of the given format; `path` is for messages only.
///
/// # Errors
/// As [`read`], without [`Error::Io`].
pub fn parse(text: &str, path: &Path, format: PoseFormat) -> Result<Trajectory> {
    let trajectory = match format {
        PoseFormat::Tum => tum::parse(text, path)?,
        PoseFormat::Kitti => kitti::parse(text, path)?,
        PoseFormat::NewerCollege => newer_college::parse(text, path)?,
        PoseFormat::G2o => {
            let graph = g2o::parse(text, path)?;
            let mut nodes = graph.nodes;
            nodes.sort_unstable_by_key(|(id, _)| *id);
            let (ids, poses) = nodes.into_iter().unzip();
            Trajectory { poses, times: None, nodes: Some(ids) }
        }
    };
    if trajectory.is_empty() {
        return Err(Error::content(path, crate::Position::File, "no pose in it", "choose another file or write it again"));
    }
    Ok(trajectory)
}

/// Whether all numbers of a pose are finite.
pub(crate) fn is_finite(pose: &Pose) -> bool {
    pose.translation.vector.iter().chain(pose.rotation.coords.iter()).all(|v| v.is_finite())
}
