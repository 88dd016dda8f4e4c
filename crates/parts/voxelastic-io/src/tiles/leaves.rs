//! The tiles of level 0 of a surface that is made piece by piece.

use super::pyramid::weld;
use super::{Cell, split};
use crate::Result;
use std::borrow::Borrow;
use std::collections::{BTreeMap, HashMap};
use voxelastic::atlas::Atlas;
use voxelastic::meshing::{SurfaceTiles, TileKey};
use voxelastic::surface::Mesh;

/// Hands the tiles of level 0 of a surface to `take`, in the order in which a writer takes them, each when all of its triangles are made. As [`split`] of the whole surface
/// they have the triangles whose centres they contain.
///
/// The lattice of the surface's own tiles is another one. So a part of those that come later is in memory: what the surface's tiles along the edge of the part that is done
/// have beyond it.
///
/// # Errors
/// What `take` returns.
pub fn leaves<A: Borrow<Atlas>>(surface: &SurfaceTiles<A>, voxel: f64, mut take: impl FnMut(Cell, Mesh) -> Result<()>) -> Result<()> {
    let mut open: BTreeMap<u64, Leaf> = BTreeMap::new();
    let mut touched: Vec<(Vec<u64>, TileKey)> = Vec::with_capacity(surface.tiles().len());
    for tile in surface.tiles() {
        let cells = cells_between(surface.bounds(*tile), voxel);
        let mut orders: Vec<u64> = cells.iter().map(Cell::order).collect();
        orders.sort_unstable();
        for cell in cells {
            open.entry(cell.order()).or_insert_with(|| Leaf { cell, expected: 0, parts: Vec::new() }).expected += 1;
        }
        touched.push((orders, *tile));
    }
    // Those that the first leaf waits for come first, then those of the second one, and so on.
    touched.sort_unstable();
    let cells_of: HashMap<TileKey, Vec<u64>> = touched.iter().map(|(orders, tile)| (*tile, orders.clone())).collect();
    let tiles: Vec<TileKey> = touched.into_iter().map(|(_, tile)| tile).collect();
    for batch in surface.batches(&tiles) {
        for (tile, mesh) in batch.iter().zip(surface.meshes(batch)) {
            for (cell, part) in split(&mesh, voxel) {
                // Every cell that the tile can reach is there.
                if let Some(leaf) = open.get_mut(&cell.order()) {
                    leaf.parts.push(part);
                }
            }
            for leaf in &cells_of[tile] {
                if let Some(leaf) = open.get_mut(leaf) {
                    leaf.expected -= 1;
                }
            }
        }
        while let Some(first) = open.first_entry().filter(|first| first.get().expected == 0) {
            let leaf = first.remove();
            let cell = leaf.cell;
            let mesh = leaf.mesh();
            if !mesh.triangles.is_empty() {
                take(cell, mesh)?;
            }
        }
    }
    Ok(())
}

/// A tile of level 0 that is not complete.
struct Leaf {
    cell: Cell,
    /// Tiles of the surface that may have parts of it.
    expected: usize,
    parts: Vec<Mesh>,
}

impl Leaf {
    /// Its parts as one mesh. Triangles of which two corners are at one place are left out.
    fn mesh(self) -> Mesh {
        let (mut mesh, mut numbers) = (Mesh::default(), HashMap::new());
        self.parts.iter().for_each(|part| weld(&mut mesh, &mut numbers, part));
        mesh
    }
}

/// The cells of level 0 that a box touches.
fn cells_between((low, high): ([f64; 3], [f64; 3]), voxel: f64) -> Vec<Cell> {
    let (Some(low), Some(high)) = (Cell::containing(low, voxel), Cell::containing(high, voxel)) else { return Vec::new() };
    let (low, high) = (low.coordinates(), high.coordinates());
    let all = (low[2]..=high[2]).flat_map(|z| (low[1]..=high[1]).flat_map(move |y| (low[0]..=high[0]).map(move |x| [x, y, z])));
    all.filter_map(|at| Cell::new(0, at)).collect()
}
