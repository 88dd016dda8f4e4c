//! Reading trajectories of any format.

use super::detect::{PoseFormat, TextContent, detect};
use super::trajectory::Trajectory;
use super::{lio_sam, rows};
use crate::{Error, Position, Result, file, g2o, text};
use std::path::Path;

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
    parse_any(&text::read(path)?, path)
}

/// Decodes a trajectory whose format is recognised.
pub(super) fn parse_any(text: &str, path: &Path) -> Result<Trajectory> {
    match detect(text) {
        Some(TextContent::Poses(format)) => parse(text, path, format),
        _ => Err(Error::content(path, Position::line(1), "not a known trajectory format", KNOWN_FORMATS)),
    }
}

/// What can be read, as a remedy.
pub(crate) const KNOWN_FORMATS: &str = "use TUM (time x y z qx qy qz qw), rows of 12 or 16 numbers (3 x 4 or 4 x 4 matrices), perhaps numbered, sec,nsec,x,y,z,qx,qy,qz,qw, \
    g2o, or name the columns in a heading: time,x,y,z,qw,qx,qy,qz or time,x,y,z,roll,pitch,yaw (radians, or yaw [deg])";

/// Decodes a trajectory of the given format; `path` is for messages only.
///
/// # Errors
/// As [`read`], without [`Error::Io`].
pub fn parse(text: &str, path: &Path, format: PoseFormat) -> Result<Trajectory> {
    let trajectory = match format {
        PoseFormat::Rows(layout) => rows::parse(text, path, layout)?,
        PoseFormat::G2o => {
            let graph = g2o::parse(text, path)?;
            let mut nodes = graph.nodes;
            nodes.sort_unstable_by_key(|(id, _)| *id);
            let (ids, poses) = nodes.into_iter().unzip();
            Trajectory { poses, times: None, nodes: Some(ids) }
        }
    };
    if trajectory.is_empty() {
        return Err(Error::content(path, Position::File, "no pose in it", "choose another file or write it again"));
    }
    Ok(trajectory)
}
