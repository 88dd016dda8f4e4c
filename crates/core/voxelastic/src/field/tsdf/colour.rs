//! Colours of surfaces: a layer beside the blocks of a TSDF that exists only where scans had colours.
//!
//! The layer is separate, so that a map without colours has no cost: blocks do not refer to it, and the update of distances does not
//! touch it. The colours of a block are at the finest scale at which a coloured point was integrated into it; coarsening the block
//! does not change them. Each voxel counts its observations, so that "unknown" is not a colour.

use crate::field::block_store::BlockStore;
use crate::octree::{NONE, SCALES, voxel_coords, voxel_index, voxels_at};
use bytemuck::{Pod, Zeroable};

/// Largest observation count: from then on the mean of a colour is an exponential moving average.
const MAX_OBSERVATIONS: u8 = 16;

/// The colour of a voxel: the mean of its observations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct ColourVoxel {
    /// Red, green and blue as in the scans, sRGB.
    pub rgb: [u8; 3],
    /// Number of observations, at most 16; 0 means unknown.
    pub observations: u8,
}

impl ColourVoxel {
    /// A colour with one observation.
    pub fn once(rgb: [u8; 3]) -> Self {
        Self { rgb, observations: 1 }
    }

    /// Whether the colour is known.
    #[inline(always)]
    pub fn is_known(self) -> bool {
        self.observations > 0
    }

    /// Mean of two colours, weighted by their observations.
    #[inline(always)]
    pub fn with(self, other: Self) -> Self {
        Self::mean([self, other])
    }

    /// Mean of colours, weighted by their observations; unknown if all of them are.
    pub fn mean(colours: impl IntoIterator<Item = Self>) -> Self {
        let (mut sum, mut count) = ([0u32; 3], 0u32);
        for colour in colours {
            (0..3).for_each(|k| sum[k] += u32::from(colour.rgb[k]) * u32::from(colour.observations));
            count += u32::from(colour.observations);
        }
        if count == 0 {
            return Self::default();
        }
        Self { rgb: sum.map(|s| ((s + count / 2) / count) as u8), observations: count.min(MAX_OBSERVATIONS.into()) as u8 }
    }
}

/// The colour array of a block: its scale, and its slot in the store.
#[derive(Clone, Copy, Debug)]
struct ArrayRef {
    scale: u8,
    slot: u32,
}

/// The colours of a TSDF, by block id.
#[derive(Clone, Debug, Default)]
pub struct ColourLayer {
    /// By block id; blocks beyond its end have no colours.
    arrays: Vec<ArrayRef>,
    store: BlockStore<ColourVoxel>,
}

impl ColourLayer {
    /// Whether no block has colours.
    pub fn is_empty(&self) -> bool {
        self.arrays.is_empty()
    }

    fn array(&self, id: u32) -> Option<ArrayRef> {
        self.arrays.get(id as usize).copied().filter(|array| array.slot != NONE)
    }

    /// The colours of block `id` and their scale; none if the block has no colours.
    pub fn block(&self, id: u32) -> Option<(usize, &[ColourVoxel])> {
        self.array(id).map(|array| (usize::from(array.scale), self.store.get(usize::from(array.scale), array.slot)))
    }

    /// The colour of voxel `c` of block `id`, in voxels of `scale`. Where the colours are finer, it is the mean of the known ones; unknown
    /// if the block has no colours.
    pub fn voxel(&self, id: u32, c: [usize; 3], scale: usize) -> ColourVoxel {
        let Some((own, colours)) = self.block(id) else { return ColourVoxel::default() };
        if own >= scale {
            return colours[voxel_index(c.map(|v| v >> (own - scale)), own)];
        }
        ColourVoxel::mean(descendants(c, scale, own).map(|index| colours[index]))
    }

    /// The colours of block `id` at `scale` or finer, and their scale. They are created if the block has none, and refined if they are
    /// coarser than `scale`.
    pub(crate) fn block_mut(&mut self, id: u32, scale: usize) -> (usize, &mut [ColourVoxel]) {
        match self.array(id) {
            Some(array) if usize::from(array.scale) > scale => {
                let coarse = usize::from(array.scale);
                let old = self.store.get(coarse, array.slot);
                let finer = (0..voxels_at(scale)).map(|i| old[voxel_index(voxel_coords(i, scale).map(|v| v >> (coarse - scale)), coarse)]);
                let finer: Vec<ColourVoxel> = finer.collect();
                self.replace(id, scale).copy_from_slice(&finer);
            }
            Some(_) => {}
            None => {
                self.replace(id, scale);
            }
        }
        let array = self.arrays[id as usize];
        (usize::from(array.scale), self.store.get_mut(usize::from(array.scale), array.slot))
    }

    /// Replaces the colours of block `id` by a new array at `scale` of unknown colours.
    pub(crate) fn replace(&mut self, id: u32, scale: usize) -> &mut [ColourVoxel] {
        if let Some(old) = self.array(id) {
            self.store.remove(old.scale.into(), old.slot);
        }
        if self.arrays.len() <= id as usize {
            self.arrays.resize(id as usize + 1, ArrayRef { scale: 0, slot: NONE });
        }
        let slot = self.store.insert(scale);
        self.arrays[id as usize] = ArrayRef { scale: scale as u8, slot };
        self.store.get_mut(scale, slot)
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        self.arrays.capacity() * size_of::<ArrayRef>() + self.store.bytes()
    }
}

/// Indices at scale `fine` of the voxels in voxel `c` of the same block at `scale`.
pub(crate) fn descendants(c: [usize; 3], scale: usize, fine: usize) -> impl Iterator<Item = usize> {
    debug_assert!(fine <= scale && scale < SCALES);
    let (shift, edge) = (scale - fine, 1 << (scale - fine));
    (0..edge * edge * edge).map(move |i| {
        let step = [i & (edge - 1), i >> shift & (edge - 1), i >> (2 * shift)];
        voxel_index(std::array::from_fn(|k| (c[k] << shift) + step[k]), fine)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_are_weighted_by_observations_and_ignore_unknown_colours() {
        let (red, blue) = (ColourVoxel { rgb: [255, 0, 0], observations: 3 }, ColourVoxel::once([0, 0, 255]));
        assert_eq!(red.with(blue), ColourVoxel { rgb: [191, 0, 64], observations: 4 });
        assert_eq!(red.with(ColourVoxel::default()), red);
        assert!(!ColourVoxel::mean([ColourVoxel::default(); 4]).is_known());
        let mut colour = ColourVoxel::once([0; 3]);
        (0..200).for_each(|_| colour = colour.with(ColourVoxel::once([90, 200, 7])));
        assert_eq!(colour.observations, MAX_OBSERVATIONS);
        assert!(colour.rgb.iter().zip([90, 200, 7]).all(|(a, b)| a.abs_diff(b) <= 9), "{colour:?}");
    }

    #[test]
    fn refining_a_block_preserves_its_colours() {
        let mut layer = ColourLayer::default();
        assert!(layer.is_empty() && layer.block(5).is_none() && !layer.voxel(5, [0; 3], 2).is_known());
        let (scale, colours) = layer.block_mut(5, 2);
        assert_eq!((scale, colours.len()), (2, 8));
        colours[voxel_index([1, 0, 1], 2)] = ColourVoxel::once([9, 8, 7]);
        assert_eq!(layer.block_mut(5, 3).0, 2, "existing colours are finer");
        let (scale, colours) = layer.block_mut(5, 0);
        assert_eq!((scale, colours.iter().filter(|t| t.is_known()).count()), (0, 64));
        assert_eq!(layer.voxel(5, [7, 3, 4], 0).rgb, [9, 8, 7]);
        assert!(!layer.voxel(5, [3, 3, 4], 0).is_known() && layer.block(4).is_none());
        assert_eq!(layer.voxel(5, [0; 3], 3).rgb, [9, 8, 7], "the mean of the known colours");
    }

    #[test]
    fn descendants_are_the_voxels_inside() {
        let found: Vec<[usize; 3]> = descendants([1, 0, 3], 1, 0).map(|i| voxel_coords(i, 0)).collect();
        assert!(found.len() == 8 && found.iter().all(|c| c.map(|v| v >> 1) == [1, 0, 3]));
        assert_eq!(descendants([2, 1, 0], 1, 1).collect::<Vec<_>>(), [voxel_index([2, 1, 0], 1)]);
    }
}
