//! Fusion of colours: the source's colours at the target's voxels, then means weighted by observations.

use super::alignment::Displacement;
use super::placement::Placement;
use crate::field::tsdf::{ColourVoxel, TsdfField};
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, Cursor, block_coords, block_key, voxel_coords, voxel_index, voxels_at};
use std::ops::Range;

/// Colours of one block in the target's lattice.
#[derive(Debug)]
struct PatchBlock {
    key: u64,
    scale: u8,
    /// None if no voxel has a colour.
    colours: Option<Box<[ColourVoxel]>>,
}

/// The source's colours in some blocks of the target's lattice; empty if the source has no colours.
#[derive(Debug, Default)]
pub(super) struct ColourPatch {
    blocks: Vec<PatchBlock>,
}

impl ColourPatch {
    /// Samples the colours of `source`, which is displaced in the target, at the voxels of blocks given by key and scale.
    pub fn sample(source: &TsdfField, placement: &Placement, displacement: &Displacement, blocks: &[(u64, u8)]) -> Self {
        if source.colours().is_empty() {
            return Self::default();
        }
        let mut cursor = Cursor::new(source.tree());
        let sample = |&(key, scale): &(u64, u8)| {
            let middle = block_coords(key).map(|c| (c as f32 + 0.5) * BLOCK_EDGE as f32);
            // One vector for the block: colours are those of whole voxels.
            let (moved, mut placement) = (placement.t_source_target.rotate(displacement.at(middle)), *placement);
            (0..3).for_each(|k| placement.t_source_target.translation[k] -= moved[k]);
            let colours = sample_block(source, &mut cursor, &placement, key, usize::from(scale));
            PatchBlock { key, scale, colours }
        };
        Self { blocks: blocks.iter().map(sample).collect() }
    }

    /// Adds the colours of blocks `range`, as far as there are any, to `target`, into which their distances are merged already.
    pub fn merge(&self, range: Range<usize>, target: &mut TsdfField) {
        let range = range.start.min(self.blocks.len())..range.end.min(self.blocks.len());
        for PatchBlock { key, scale, colours } in self.blocks.get(range).unwrap_or_default() {
            if let (Some(colours), Some(id)) = (colours, target.find(*key)) {
                let (target_scale, target_colours) = target.colours.block_mut(id, usize::from(target.blocks[id].finest));
                for (index, colour) in target_colours.iter_mut().enumerate() {
                    // The target's block is at least as fine as the patch's.
                    let c = voxel_coords(index, target_scale).map(|v| v << target_scale >> scale);
                    *colour = colour.with(colours[voxel_index(c, usize::from(*scale))]);
                }
            }
        }
    }
}

/// Colours of the target's block `key` at `scale`, each from the source's voxel that contains its centre.
fn sample_block(source: &TsdfField, cursor: &mut Cursor, placement: &Placement, key: u64, scale: usize) -> Option<Box<[ColourVoxel]>> {
    let corner = block_coords(key).map(|c| (c * BLOCK_EDGE as i32) as f32);
    let edge = (1 << scale) as f32;
    let colour = |index: usize| {
        let c = voxel_coords(index, scale);
        let centre = placement.t_source_target.apply(std::array::from_fn(|k| corner[k] + (c[k] as f32 + 0.5) * edge));
        let at = centre.map(|v| v.floor() as i32);
        let Some(id) = cursor.block(source.tree(), block_key(at.map(|v| v >> BLOCK_SHIFT))) else { return ColourVoxel::default() };
        source.colours().voxel(id, at.map(|v| (v & (BLOCK_EDGE as i32 - 1)) as usize >> scale), scale)
    };
    let colours: Box<[ColourVoxel]> = (0..voxels_at(scale)).map(colour).collect();
    colours.iter().any(|c| c.is_known()).then_some(colours)
}
