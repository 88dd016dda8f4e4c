//! A block that a scan touches, with its rays.

use crate::field::tsdf::Block;
use crate::integrate::rays::scale::ScaleRule;
use crate::octree::BLOCK_EDGE;

/// A block and the records of the rays that pass it.
#[derive(Clone, Copy, Debug)]
pub(super) struct BlockRun {
    pub block: u32,
    /// Its rays: records `start..end` of the selection.
    pub start: u32,
    pub end: u32,
    pub change: ScaleChange,
    /// A bit for each octant of the block: whether rays that end in it are integrated. [`ALL_OCTANTS`] integrates all rays, wherever they end.
    pub octant_mask: u8,
}

/// The mask with which all rays of a block are integrated.
pub(super) const ALL_OCTANTS: u8 = u8::MAX;

impl BlockRun {
    /// Whether a ray that ends at `point` is integrated into the block with smallest corner `corner`, finest voxels.
    #[inline(always)]
    pub fn takes(&self, point: [f32; 3], corner: [f32; 3]) -> bool {
        self.octant_mask == ALL_OCTANTS || self.octant_mask & octant_bit(point, corner) != 0
    }
}

/// The octant of the block with smallest corner `corner` that contains `point`, as a bit; none outside of the block.
#[inline(always)]
pub(super) fn octant_bit(point: [f32; 3], corner: [f32; 3]) -> u8 {
    let within: [f32; 3] = std::array::from_fn(|k| point[k] - corner[k]);
    let edge = BLOCK_EDGE as f32;
    let octant = (0..3).fold(0, |octant, k| octant | u32::from(within[k] >= edge / 2.0) << k);
    if within.iter().all(|c| (0.0..edge).contains(c)) { 1 << octant } else { 0 }
}

/// How a block changes scale in a scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum ScaleChange {
    None,
    Coarser,
    /// To a finer array that exists.
    Finer,
    /// To a finer array that is new.
    FinerNew,
}

impl ScaleChange {
    /// The change of `block`, `distance` metres from the sensor.
    pub fn of(block: &Block, rule: &ScaleRule, distance: f32) -> Self {
        let (current, finest) = (usize::from(block.scale), usize::from(block.finest));
        match rule.next(current, distance) {
            next if next > current => Self::Coarser,
            next if next == current => Self::None,
            next if next < finest => Self::FinerNew,
            _ => Self::Finer,
        }
    }

    /// Whether the block becomes finer.
    pub fn is_finer(self) -> bool {
        matches!(self, Self::Finer | Self::FinerNew)
    }
}
