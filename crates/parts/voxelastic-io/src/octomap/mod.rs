//! OctoMap's octree files: `.bt` (free or occupied, two bits a node) and `.ot` (log-odds).
//!
//! Both begin with lines of text: a comment that names the format, `id OcTree`, `size` (number of nodes), `res` (edge of a
//! smallest voxel, metres), `data`; then the nodes, parents first, children in the order of x + 2 y + 4 z. The tree has
//! sixteen levels and its centre at the origin.
//!
//! - `.bt`: two bytes per inner node, two bits per child from the lowest: 00 unknown, 01 free, 10 occupied, 11 inner (the
//!   lower bit first stands for free). Inner children follow in order.
//! - `.ot`: per node its log-odds (f32, little endian) and a byte with a bit per child; the children follow in order. An
//!   inner node has the largest log-odds of its children.

mod encode;
#[cfg(test)]
mod tests;

use crate::file::write_atomically;
use crate::{Error, Result};
use encode::{NodeValues, Tree, encode};
use std::io::Write;
use std::path::Path;
use voxelastic::query::Cube;

/// Writes `cubes`, as [`resample`](voxelastic::query::AtlasQuery::resample) gives them for smallest cubes of `voxel`
/// metres, as an OctoMap of states (`.bt`), atomically.
///
/// # Errors
/// [`Error::Unwritable`] for a map that reaches farther than 32,768 voxels from the origin, for a voxel size that is none
/// and for cubes that are not in Morton order; [`Error::Io`] if the disk refuses.
pub fn write_bt(path: impl AsRef<Path>, voxel: f64, cubes: &[Cube]) -> Result<()> {
    write(path.as_ref(), voxel, cubes, NodeValues::States, "# Octomap OcTree binary file")
}

/// As [`write_bt`], with log-odds (`.ot`).
///
/// # Errors
/// As [`write_bt`].
pub fn write_ot(path: impl AsRef<Path>, voxel: f64, cubes: &[Cube]) -> Result<()> {
    write(path.as_ref(), voxel, cubes, NodeValues::LogOdds, "# Octomap OcTree file")
}

/// The nodes of a `.bt` file without the text before them, as `octomap_msgs/Octomap` carries them.
///
/// # Errors
/// What is wrong with the cubes, as for [`write_bt`].
pub fn state_nodes(cubes: &[Cube]) -> std::result::Result<Vec<u8>, String> {
    Ok(encode(&Tree::new(cubes)?, NodeValues::States).1)
}

fn write(path: &Path, voxel: f64, cubes: &[Cube], values: NodeValues, title: &str) -> Result<()> {
    if !(voxel.is_finite() && voxel > 0.0) {
        return Err(Error::unwritable(path, format!("a voxel cannot have an edge of {voxel} m")));
    }
    let tree = Tree::new(cubes).map_err(|problem| Error::unwritable(path, problem))?;
    let (nodes, data) = encode(&tree, values);
    write_atomically(path, |out| {
        // Readers know a file by its first line.
        write!(out, "{title}\n# made by voxelastic\nid OcTree\nsize {nodes}\nres {voxel}\ndata\n")?;
        out.write_all(&data)
    })
}
