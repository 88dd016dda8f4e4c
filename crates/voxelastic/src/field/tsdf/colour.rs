//! Colours of surfaces: a layer over a TSDF's blocks that exists only where scans had colours.
//!
//! It keeps to itself, so that a map without colours pays nothing: blocks do not know of it, and the update of distances
//! does not touch it. A block's colours are at the finest scale that the block had when a coloured point was last seen in it; going
//! coarser leaves them alone. Each voxel says how often its colour was seen, so that "unknown" is not a colour.

use crate::field::BlockStore;
use crate::octree::{NONE, SCALES, voxel_coords, voxel_index, voxels_at};
use bytemuck::{Pod, Zeroable};

/// Observations after which a colour's mean becomes a moving one.
const MOST_SEEN: u8 = 16;

/// The colour of a voxel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Tint {
    /// Red, green and blue as the scans had them, sRGB.
    pub rgb: [u8; 3],
    /// Observations, at most 16; 0 means unknown.
    pub seen: u8,
}

impl Tint {
    /// A colour that was seen once.
    pub fn once(rgb: [u8; 3]) -> Self {
        Self { rgb, seen: 1 }
    }

    /// Whether the colour is known.
    #[inline(always)]
    pub fn is_known(self) -> bool {
        self.seen > 0
    }

    /// The mean of two colours by their observations.
    #[inline(always)]
    pub fn with(self, other: Self) -> Self {
        Self::mean([self, other])
    }

    /// The mean of colours by their observations.
    pub fn mean(tints: impl IntoIterator<Item = Self>) -> Self {
        let (mut sum, mut seen) = ([0u32; 3], 0u32);
        for tint in tints {
            (0..3).for_each(|k| sum[k] += u32::from(tint.rgb[k]) * u32::from(tint.seen));
            seen += u32::from(tint.seen);
        }
        if seen == 0 {
            return Self::default();
        }
        Self { rgb: sum.map(|s| ((s + seen / 2) / seen) as u8), seen: seen.min(MOST_SEEN.into()) as u8 }
    }
}

/// Where a block's colours lie.
#[derive(Clone, Copy, Debug)]
struct Place {
    scale: u8,
    slot: u32,
}

/// The colours of a field, by block.
#[derive(Clone, Debug, Default)]
pub struct ColourLayer {
    /// By block id; blocks beyond its end have no colours.
    places: Vec<Place>,
    tints: BlockStore<Tint>,
}

impl ColourLayer {
    /// Whether no block has colours.
    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    fn place(&self, id: u32) -> Option<Place> {
        self.places.get(id as usize).copied().filter(|place| place.slot != NONE)
    }

    /// The colours of block `id` and their scale.
    pub fn of(&self, id: u32) -> Option<(usize, &[Tint])> {
        self.place(id).map(|place| (usize::from(place.scale), self.tints.get(usize::from(place.scale), place.slot)))
    }

    /// The colour of voxel `c` of block `id` at `scale`: where the colours are finer, the mean of what is known there.
    pub fn tint(&self, id: u32, c: [usize; 3], scale: usize) -> Tint {
        let Some((own, tints)) = self.of(id) else { return Tint::default() };
        if own >= scale {
            return tints[voxel_index(c.map(|v| v >> (own - scale)), own)];
        }
        Tint::mean(cube(c, scale, own).map(|index| tints[index]))
    }

    /// The colours of block `id` at `scale` or, if they are finer already, at their own; they are made if there are none, and refined if
    /// they are coarser.
    pub(crate) fn open(&mut self, id: u32, scale: usize) -> (usize, &mut [Tint]) {
        match self.place(id) {
            Some(place) if usize::from(place.scale) > scale => {
                let coarse = usize::from(place.scale);
                let old = self.tints.get(coarse, place.slot);
                let finer = (0..voxels_at(scale)).map(|i| old[voxel_index(voxel_coords(i, scale).map(|v| v >> (coarse - scale)), coarse)]);
                let finer: Vec<Tint> = finer.collect();
                self.replace(id, scale).copy_from_slice(&finer);
            }
            Some(_) => {}
            None => {
                self.replace(id, scale);
            }
        }
        let place = self.places[id as usize];
        (usize::from(place.scale), self.tints.get_mut(usize::from(place.scale), place.slot))
    }

    /// A new array for block `id` instead of the one it has, unknown all over.
    pub(crate) fn replace(&mut self, id: u32, scale: usize) -> &mut [Tint] {
        if let Some(old) = self.place(id) {
            self.tints.remove(old.scale.into(), old.slot);
        }
        if self.places.len() <= id as usize {
            self.places.resize(id as usize + 1, Place { scale: 0, slot: NONE });
        }
        let slot = self.tints.insert(scale);
        self.places[id as usize] = Place { scale: scale as u8, slot };
        self.tints.get_mut(scale, slot)
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.places.capacity() * size_of::<Place>() + self.tints.bytes()
    }
}

/// Indices at `fine` of the voxels in voxel `c` of the same block at `scale`.
pub(crate) fn cube(c: [usize; 3], scale: usize, fine: usize) -> impl Iterator<Item = usize> {
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
    fn means_count_observations_and_leave_the_unknown_out() {
        let (red, blue) = (Tint { rgb: [255, 0, 0], seen: 3 }, Tint::once([0, 0, 255]));
        assert_eq!(red.with(blue), Tint { rgb: [191, 0, 64], seen: 4 });
        assert_eq!(red.with(Tint::default()), red);
        assert!(!Tint::mean([Tint::default(); 4]).is_known());
        let mut tint = Tint::once([0; 3]);
        (0..200).for_each(|_| tint = tint.with(Tint::once([90, 200, 7])));
        assert_eq!(tint.seen, MOST_SEEN);
        assert!(tint.rgb.iter().zip([90, 200, 7]).all(|(a, b)| a.abs_diff(b) <= 9), "{tint:?}");
    }

    #[test]
    fn a_block_that_became_finer_keeps_its_colours() {
        let mut layer = ColourLayer::default();
        assert!(layer.is_empty() && layer.of(5).is_none() && !layer.tint(5, [0; 3], 2).is_known());
        let (scale, tints) = layer.open(5, 2);
        assert_eq!((scale, tints.len()), (2, 8));
        tints[voxel_index([1, 0, 1], 2)] = Tint::once([9, 8, 7]);
        assert_eq!(layer.open(5, 3).0, 2, "coarser is not asked for");
        let (scale, tints) = layer.open(5, 0);
        assert_eq!((scale, tints.iter().filter(|t| t.is_known()).count()), (0, 64));
        assert_eq!(layer.tint(5, [7, 3, 4], 0).rgb, [9, 8, 7]);
        assert!(!layer.tint(5, [3, 3, 4], 0).is_known() && layer.of(4).is_none());
        assert_eq!(layer.tint(5, [0; 3], 3).rgb, [9, 8, 7], "the mean of what is known");
    }

    #[test]
    fn cubes_hold_the_voxels_below() {
        let found: Vec<[usize; 3]> = cube([1, 0, 3], 1, 0).map(|i| voxel_coords(i, 0)).collect();
        assert!(found.len() == 8 && found.iter().all(|c| c.map(|v| v >> 1) == [1, 0, 3]));
        assert_eq!(cube([2, 1, 0], 1, 1).collect::<Vec<_>>(), [voxel_index([2, 1, 0], 1)]);
    }
}
