//! Fusion of colours: those of the source at the target's voxels, then means by how often each was seen.

use super::Placement;
use crate::field::tsdf::{Tint, TsdfField};
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, Cursor, block_coords, block_key, voxel_coords, voxel_index, voxels_at};
use std::ops::Range;

/// A block of the patch.
#[derive(Debug)]
struct PatchBlock {
    key: u64,
    scale: u8,
    /// Its colours, if it has any.
    tints: Option<Box<[Tint]>>,
}

/// The source's colours in the blocks of a patch in the target's lattice; empty for sources without.
#[derive(Debug, Default)]
pub(super) struct ColourPatch {
    blocks: Vec<PatchBlock>,
}

impl ColourPatch {
    /// Samples the colours of `source` at the voxels of the blocks at `places`: keys and scales.
    pub fn sample(source: &TsdfField, placement: &Placement, places: &[(u64, u8)]) -> Self {
        if source.colours().is_empty() {
            return Self::default();
        }
        let mut cursor = Cursor::new(source.tree());
        let sample = |&(key, scale): &(u64, u8)| {
            let tints = block(source, &mut cursor, placement, key, usize::from(scale));
            PatchBlock { key, scale, tints }
        };
        Self { blocks: places.iter().map(sample).collect() }
    }

    /// Adds the colours of the blocks numbered `range` to `target`, which has their distances by now.
    pub fn merge(&self, range: Range<usize>, target: &mut TsdfField) {
        for PatchBlock { key, scale, tints } in self.blocks.get(range).unwrap_or_default() {
            if let (Some(tints), Some(id)) = (tints, target.find(*key)) {
                let (own, into) = target.colours.open(id, usize::from(target.blocks[id].finest));
                for (index, tint) in into.iter_mut().enumerate() {
                    // The target's block is at least as fine as the patch's.
                    let c = voxel_coords(index, own).map(|v| v << own >> scale);
                    *tint = tint.with(tints[voxel_index(c, usize::from(*scale))]);
                }
            }
        }
    }
}

/// The colours of the target's block `key` at `scale`, each from the source's voxel that holds its centre.
fn block(source: &TsdfField, cursor: &mut Cursor, placement: &Placement, key: u64, scale: usize) -> Option<Box<[Tint]>> {
    let corner = block_coords(key).map(|c| (c * BLOCK_EDGE as i32) as f32);
    let edge = (1 << scale) as f32;
    let tint = |index: usize| {
        let c = voxel_coords(index, scale);
        let centre = placement.t_source_target.apply(std::array::from_fn(|k| corner[k] + (c[k] as f32 + 0.5) * edge));
        let at = centre.map(|v| v.floor() as i32);
        let Some(id) = cursor.block(source.tree(), block_key(at.map(|v| v >> BLOCK_SHIFT))) else { return Tint::default() };
        source.colours().tint(id, at.map(|v| (v & (BLOCK_EDGE as i32 - 1)) as usize >> scale), scale)
    };
    let tints: Box<[Tint]> = (0..voxels_at(scale)).map(tint).collect();
    tints.iter().any(|t| t.is_known()).then_some(tints)
}
