//! Writing the trajectory.

use super::tracked::Tracked;
use std::path::{Path, PathBuf};
use voxelastic::Pose;
use voxelastic::event::Edge;
use voxelastic_io::{PoseGraph, g2o, poses};

/// A file for the trajectory, whose format its extension says.
#[derive(Clone, Debug)]
pub struct OutputFile {
    path: PathBuf,
    format: Format,
}

#[derive(Clone, Copy, Debug)]
enum Format {
    Tum,
    Kitti,
    G2o,
}

impl OutputFile {
    /// Parses the argument.
    pub fn parse(text: &str) -> Result<Self, String> {
        let path = PathBuf::from(text);
        let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        let format = match extension.as_deref() {
            Some("tum") => Format::Tum,
            Some("txt" | "kitti") => Format::Kitti,
            Some("g2o") => Format::G2o,
            _ => return Err("the name must end in .tum, .txt (KITTI rows) or .g2o".to_owned()),
        };
        Ok(Self { path, format })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes the poses: TUM and g2o those that were measured, KITTI rows all of them, since a row has no name.
    pub fn write(&self, tracked: &[Tracked]) -> voxelastic_io::Result<()> {
        let measured = tracked.iter().filter(|t| t.is_tracked());
        match self.format {
            Format::Tum => poses::write_tum(&self.path, &measured.map(|t| (t.time, *t.pose())).collect::<Vec<_>>()),
            Format::Kitti => poses::write_kitti(&self.path, &tracked.iter().map(|t| *t.pose()).collect::<Vec<Pose>>()),
            Format::G2o => g2o::write(&self.path, &graph(&measured.collect::<Vec<_>>())),
        }
    }
}

/// Nodes, and an edge between neighbours of the same piece.
fn graph(tracked: &[&Tracked]) -> PoseGraph {
    let edge = |pair: &[&Tracked]| {
        let [a, b] = [pair[0], pair[1]];
        (a.report.piece == b.report.piece).then(|| {
            let t_from_to = a.pose().inv_mul(b.pose());
            Edge { from: a.node, to: b.node, t_from_to, information: Some(b.report.edge_information(t_from_to.translation.vector.norm())) }
        })
    };
    PoseGraph {
        nodes: tracked.iter().map(|t| (t.node, *t.pose())).collect(),
        edges: tracked.windows(2).filter_map(edge).collect(),
        fixed: tracked.first().map(|t| t.node).into_iter().collect(),
    }
}
