//! Which returns of a scan are used, by patches of its range image: where the map knows a surface well, scans take turns.

/// Columns of a patch; as many as are processed together when planes are fitted.
pub(crate) const PATCH_COLUMNS: usize = 32;
/// Rows of a patch: few, so that a patch has little else than one surface.
pub(crate) const PATCH_ROWS: usize = 4;

/// The weight of the returns of each patch of a range image: 1; or 0 where it is the turn of another scan, and the number of scans that take turns where it is
/// the turn of this one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct PatchWeights {
    /// Patches in a row of patches.
    across: usize,
    weights: Vec<u8>,
}

impl PatchWeights {
    /// Weights of the patches of an image, from the number of scans that take turns in each, a power of two. Scans are numbered by `turn`. A scan uses whole columns of
    /// patches, because the sums for a plane go across several rows of patches.
    pub fn new((rows, columns): (usize, usize), turn: usize, sharing: impl Fn(usize) -> u8) -> Self {
        /// Odd, so that it comes to all columns of patches; not one, as a sensor that moves could then see the same surface each time.
        const STEP: usize = 3;
        let across = columns.div_ceil(PATCH_COLUMNS);
        let weight = |patch: usize| {
            let scans = sharing(patch);
            if (patch % across + STEP * turn).is_multiple_of(scans.into()) { scans } else { 0 }
        };
        Self { across, weights: (0..across * rows.div_ceil(PATCH_ROWS)).map(weight).collect() }
    }

    /// The number of the patch of the pixel in a row and column of an image with so many columns.
    #[inline(always)]
    pub fn patch_of(columns: usize, (row, column): (usize, usize)) -> usize {
        row / PATCH_ROWS * columns.div_ceil(PATCH_COLUMNS) + column / PATCH_COLUMNS
    }

    /// Number of patches of an image.
    pub fn count((rows, columns): (usize, usize)) -> usize {
        columns.div_ceil(PATCH_COLUMNS) * rows.div_ceil(PATCH_ROWS)
    }

    /// The weight of the returns in the pixel in a row and column.
    #[inline(always)]
    pub fn of(&self, (row, column): (usize, usize)) -> u8 {
        self.weights[row / PATCH_ROWS * self.across + column / PATCH_COLUMNS]
    }

    /// Whether all weights are 1.
    pub fn are_equal(&self) -> bool {
        self.weights.iter().all(|weight| *weight == 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_pixel_is_used_as_often_as_without_turns(rows in 1usize..20, columns in 1usize..200, sharing in prop::collection::vec(0u32..4, 1..40), first in 0usize..100) {
            let size = (rows, columns);
            let sharing = |patch: usize| 1 << sharing[patch % sharing.len()];
            let turns: Vec<PatchWeights> = (first..first + 8).map(|turn| PatchWeights::new(size, turn, sharing)).collect();
            for place in (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column))) {
                let scans = sharing(PatchWeights::patch_of(columns, place));
                prop_assert!(PatchWeights::patch_of(columns, place) < PatchWeights::count(size));
                let weights: Vec<u8> = turns.iter().map(|weights| weights.of(place)).collect();
                prop_assert!(weights.iter().all(|weight| [0, scans].contains(weight)), "{weights:?} where {scans} take turns");
                prop_assert_eq!(weights.iter().map(|weight| usize::from(*weight)).sum::<usize>(), 8);
            }
            let has_turns = (0..PatchWeights::count(size)).any(|patch| sharing(patch) > 1);
            prop_assert!(turns.iter().all(|weights| weights.are_equal() != has_turns));
        }
    }
}
