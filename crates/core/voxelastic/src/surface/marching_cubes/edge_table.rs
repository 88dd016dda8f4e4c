//! The cases of marching cubes with edges as indices into a table of a block's vertices.

use super::mc_table::{CASES, EDGES};
use std::sync::LazyLock;

/// Voxels along an edge of a block and of the first of those beyond.
pub(crate) const WIDE: usize = 9;

/// Entries of the table per axis.
pub(crate) const AXIS: usize = WIDE * WIDE * WIDE;

/// The cases of marching cubes with edges as indices into the table, from that of the cell's lower corner.
pub(crate) struct EdgeTable {
    pub starts: [u16; 256],
    pub counts: [u8; 256],
    pub corners: Vec<[u16; 3]>,
}

pub(crate) static TABLE: LazyLock<EdgeTable> = LazyLock::new(|| {
    let mut table = EdgeTable { starts: [0; 256], counts: [0; 256], corners: Vec::new() };
    let index = |edge: u8| {
        let (corner, axis) = (EDGES[usize::from(edge)][0], usize::from(edge) / 4);
        (AXIS * axis + (corner & 1) + WIDE * ((corner >> 1 & 1) + WIDE * (corner >> 2))) as u16
    };
    for (i, triangles) in CASES.iter().enumerate() {
        (table.starts[i], table.counts[i]) = (table.corners.len() as u16, triangles.len() as u8);
        table.corners.extend(triangles.iter().map(|triangle| triangle.map(index)));
    }
    table
});
