//! Writing g2o.

use crate::file::write_atomically;
use crate::pose_check::is_finite;
use crate::{Error, PoseGraph, Result};
use std::io::Write;
use std::path::Path;
use voxelastic::Pose;

/// Diagonal of the information that an edge without any gets: 1 per square metre and square radian.
const UNIT_INFORMATION: [f64; 21] = {
    let mut upper = [0.0; 21];
    let (mut k, mut row) = (0, 0);
    while row < 6 {
        upper[k] = 1.0;
        k += 6 - row;
        row += 1;
    }
    upper
};

/// Writes a pose graph, atomically. Numbers are written so that they read back as the same bits.
/// An edge without information is written with the unit matrix, since the format knows no absence.
///
/// # Errors
/// [`Error::Unwritable`] for a number that is not finite; [`Error::Io`] if the disk refuses.
pub fn write(path: impl AsRef<Path>, graph: &PoseGraph) -> Result<()> {
    let path = path.as_ref();
    for (id, pose) in &graph.nodes {
        check(path, pose, &format!("node {id}"))?;
    }
    for edge in &graph.edges {
        check(path, &edge.t_from_to, &format!("edge {} {}", edge.from, edge.to))?;
        if edge.information.is_some_and(|i| i.iter().any(|v| !v.is_finite())) {
            return Err(Error::unwritable(path, format!("edge {} {} has information that is not finite", edge.from, edge.to)));
        }
    }
    write_atomically(path, |w| {
        for (id, pose) in &graph.nodes {
            writeln!(w, "VERTEX_SE3:QUAT {id} {}", Numbers(pose))?;
        }
        for id in &graph.fixed {
            writeln!(w, "FIX {id}")?;
        }
        for edge in &graph.edges {
            write!(w, "EDGE_SE3:QUAT {} {} {}", edge.from, edge.to, Numbers(&edge.t_from_to))?;
            for value in edge.information.as_ref().unwrap_or(&UNIT_INFORMATION) {
                write!(w, " {value}")?;
            }
            writeln!(w)?;
        }
        Ok(())
    })
}

fn check(path: &Path, pose: &Pose, what: &str) -> Result<()> {
    if is_finite(pose) { Ok(()) } else { Err(Error::unwritable(path, format!("the pose of {what} is not finite"))) }
}

/// `x y z qx qy qz qw`, each in the shortest form that reads back as the same number.
struct Numbers<'a>(&'a Pose);

impl std::fmt::Display for Numbers<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (t, q) = (&self.0.translation.vector, &self.0.rotation.coords);
        write!(f, "{} {} {} {} {} {} {}", t.x, t.y, t.z, q.x, q.y, q.z, q.w)
    }
}
