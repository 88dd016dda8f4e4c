//! Returns in the order of cells within cells, so that the returns of every cell of every size follow each other.

use crate::geometry::{morton, sort_by_bits};

/// Edge of the smallest cells, metres.
pub(super) const EDGE: f32 = 0.04;
/// Sizes of cells: each is twice as wide as the last.
pub(super) const LEVELS: u32 = 9;

/// Keys of returns; scratch memory.
#[derive(Clone, Debug, Default)]
pub(crate) struct CellOrder {
    /// Morton key of the smallest cell of each return, ascending.
    pub(super) keys: Vec<u64>,
    records: Vec<u64>,
    spare: Vec<u64>,
}

impl CellOrder {
    /// Sorts `which`, indices into `points`, by their cells; those of one cell stay in their order.
    pub(crate) fn sort(&mut self, points: &[[f32; 3]], which: &mut Vec<u32>) {
        let index_bits = (u64::BITS - (which.len() as u64).leading_zeros()).max(1);
        // Farther away than these bits can tell, returns are in the outermost cells: searches miss some of their neighbours.
        let axis_bits = ((u64::BITS - index_bits) / 3).min(morton::AXIS_BITS);
        let half = 1i32 << (axis_bits - 1);
        let cell = |c: f32| ((c / EDGE).floor() as i32).clamp(-half, half - 1).wrapping_add(half) as u32;
        self.records.clear();
        self.records.extend((0u64..).zip(&*which).map(|(k, &i)| morton::encode(points[i as usize].map(cell)) << index_bits | k));
        sort_by_bits(&mut self.records, &mut self.spare, index_bits, index_bits + 3 * axis_bits);
        self.keys.clear();
        self.keys.extend(self.records.iter().map(|record| record >> index_bits));
        let sorted = self.records.iter().map(|record| which[(record & ((1 << index_bits) - 1)) as usize]).collect();
        *which = sorted;
    }
}

/// Where the returns of each cell of one size are.
#[derive(Clone, Debug, Default)]
pub(super) struct CellTable {
    /// Key and range of the returns of a cell, at the hash of the key or after it; no returns in free slots.
    slots: Vec<(u64, u32, u32)>,
    shift: u32,
}

impl CellTable {
    /// Lists the cells of `level` of returns with sorted `keys`.
    pub(super) fn fill(&mut self, keys: &[u64], level: u32) {
        let cells = keys.chunk_by(|a, b| a >> (3 * level) == b >> (3 * level));
        let count = cells.clone().count();
        let size = (2 * count).next_power_of_two().max(2);
        self.shift = u64::BITS - size.trailing_zeros();
        self.slots.clear();
        self.slots.resize(size, (0, 0, 0));
        let mut start = 0;
        for cell in cells {
            let (key, end) = (cell[0] >> (3 * level), start + cell.len() as u32);
            let mut slot = self.first_slot(key);
            while self.slots[slot].1 < self.slots[slot].2 {
                slot = (slot + 1) & (size - 1);
            }
            self.slots[slot] = (key, start, end);
            start = end;
        }
    }

    fn first_slot(&self, key: u64) -> usize {
        (key.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> self.shift) as usize
    }

    /// The returns of a cell.
    pub(super) fn get(&self, key: u64) -> std::ops::Range<u32> {
        let mut slot = self.first_slot(key);
        loop {
            let (found, start, end) = self.slots[slot];
            if found == key || start == end {
                return start..end;
            }
            slot = (slot + 1) & (self.slots.len() - 1);
        }
    }

    /// The returns of a cell and of the 26 around it.
    pub(super) fn around(&self, key: u64) -> [std::ops::Range<u32>; 27] {
        // On each axis the cell before, the cell, and the one after; a key's bits of other axes are carried over.
        let axis = |k: u32| {
            let mask = morton::AXIS_MASK << k;
            [(key & mask).wrapping_sub(1 << k) & mask, key & mask, (key | !mask).wrapping_add(1 << k) & mask]
        };
        let [x, y, z] = [axis(0), axis(1), axis(2)];
        std::array::from_fn(|i| self.get(x[i % 3] | y[i / 3 % 3] | z[i / 9]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn cells_have_the_returns_within_their_bounds(points in prop::collection::vec(prop::array::uniform3(-8f32..8.0), 1..300), level in 0u32..LEVELS) {
            let (mut order, mut which, mut table) = (CellOrder::default(), (0..points.len() as u32).collect(), CellTable::default());
            order.sort(&points, &mut which);
            let sorted: Vec<[f32; 3]> = which.iter().map(|&i| points[i as usize]).collect();
            which.sort_unstable();
            prop_assert!(which.iter().copied().eq(0..points.len() as u32), "each once");
            table.fill(&order.keys, level);
            let cell = |p: &[f32; 3]| p.map(|c| (c / EDGE).floor() as i64 >> level);
            for (p, key) in sorted.iter().zip(&order.keys) {
                let mut found: Vec<u32> = table.around(key >> (3 * level)).into_iter().flatten().collect();
                found.sort_unstable();
                let near = |q: &[f32; 3]| cell(q).iter().zip(cell(p)).all(|(a, b)| (a - b).abs() <= 1);
                let expected: Vec<u32> = (0u32..).zip(&sorted).filter(|(_, q)| near(q)).map(|(j, _)| j).collect();
                prop_assert_eq!(found, expected);
            }
        }
    }
}
