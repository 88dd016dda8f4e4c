//! Many points in the order of where they are: what is looked up for one of them is at hand for the next.

use super::shape::moved;
use crate::geometry::{Pose, morton, sort_by_bits};
use rayon::prelude::*;

/// Fewer points than this are looked up one by one: few of them share a block.
pub(super) const FEW: usize = 4096;

/// Points that are sorted at once.
const MOST: usize = 1 << INDEX_BITS;

/// Bits of a point's index; the bits above it hold the cell that the point is in.
const INDEX_BITS: u32 = 20;

/// Most bits of a cell's coordinate along an axis.
const CELL_BITS: u32 = 14;

/// log2 of the cells along the edge of a cube whose points are answered together.
const CUBE_BITS: u32 = 3;

/// Most points that are answered together.
const PER_TASK: usize = 1 << 14;

/// A grid of cubes over the map, by which points are sorted.
#[derive(Debug)]
pub(super) struct Cells {
    low: [f64; 3],
    high: [f64; 3],
    /// Smallest edge of a cube, metres.
    edge: f64,
}

impl Cells {
    /// A grid of cubes with edges of `edge` metres, or larger in a map of kilometres.
    pub fn new(edge: f64) -> Self {
        Self { low: [f64::INFINITY; 3], high: [f64::NEG_INFINITY; 3], edge }
    }

    /// Extends it over the box from `low` to `high` in a frame at `t_map_frame`.
    pub fn cover(&mut self, low: [f64; 3], high: [f64; 3], t_map_frame: &Pose) {
        for corner in 0..8 {
            let at = moved(t_map_frame, std::array::from_fn(|k| if corner >> k & 1 == 0 { low[k] } else { high[k] }));
            for (k, at) in at.into_iter().enumerate() {
                // Rounding loses no point at the faces.
                self.low[k] = self.low[k].min(at - self.edge);
                self.high[k] = self.high[k].max(at + self.edge);
            }
        }
    }

    /// Answers for `points` (map frame), each of which is `unknown` outside of the grid. `look_up` gets points in a cube of eight cells along each axis, and
    /// answers that are `unknown` at first; what a thread keeps from one such call to the next is made by `scratch`.
    pub fn answer<T, A, S>(
        &self,
        points: &[[T; 3]],
        unknown: A,
        scratch: impl Fn() -> S + Sync,
        look_up: impl Fn(&mut S, &[[f64; 3]], &mut [A]) + Sync,
    ) -> Vec<A>
    where
        T: Copy + Into<f64> + Sync,
        A: Copy + Send + Sync,
    {
        let mut answers = vec![unknown; points.len()];
        let extent = (0..3).map(|k| self.high[k] - self.low[k]).fold(0.0, f64::max);
        if !(extent > 0.0 && extent.is_finite()) {
            return answers;
        }
        let bits = (0..CELL_BITS).find(|bits| f64::from(1 << bits) * self.edge > extent).unwrap_or(CELL_BITS);
        for (points, answers) in points.chunks(MOST).zip(answers.chunks_mut(MOST)) {
            let records = self.sorted(points, extent, bits);
            let mut found = vec![unknown; records.len()];
            let tasks = tasks(&records, &mut found);
            tasks.into_par_iter().for_each_init(
                || (Vec::new(), scratch()),
                |(near, scratch), (records, found)| {
                    // Points come from all over the memory: faster all together than one before each look.
                    near.clear();
                    near.extend(records.iter().map(|record| points[index_of(*record)].map(Into::into)));
                    look_up(scratch, near, found);
                },
            );
            const NONE: u32 = u32::MAX;
            let mut places = vec![NONE; points.len()];
            for (place, record) in (0..).zip(&records) {
                places[index_of(*record)] = place;
            }
            let pairs = answers.par_iter_mut().zip(places).with_min_len(PER_TASK).filter(|(_, place)| *place != NONE);
            pairs.for_each(|(answer, place)| *answer = found[place as usize]);
        }
        answers
    }

    /// For each point in the grid, its cell in Morton order above its index, by ascending cells.
    fn sorted<T: Copy + Into<f64> + Sync>(&self, points: &[[T; 3]], extent: f64, bits: u32) -> Vec<u64> {
        let (per_metre, most) = (1.0 / self.edge.max(extent / f64::from(1 << bits)), (1 << bits) - 1);
        let record = |(index, p): (usize, &[T; 3])| {
            let p = p.map(Into::into);
            // Not for a coordinate that is no number.
            let is_inside = (0..3).all(|k| p[k] >= self.low[k] && p[k] <= self.high[k]);
            let cell = || morton::encode(std::array::from_fn(|k| (((p[k] - self.low[k]) * per_metre) as u32).min(most)));
            is_inside.then(|| cell() << INDEX_BITS | index as u64)
        };
        let mut records: Vec<u64> = points.par_iter().enumerate().with_min_len(PER_TASK).filter_map(record).collect();
        sort_by_bits(&mut records, &mut Vec::new(), INDEX_BITS, INDEX_BITS + 3 * bits);
        records
    }
}

/// The records of each cube with the places of their answers; those of many points in several parts.
fn tasks<'a, A>(records: &'a [u64], mut found: &'a mut [A]) -> Vec<(&'a [u64], &'a mut [A])> {
    let cube = |record: u64| record >> (INDEX_BITS + 3 * CUBE_BITS);
    let mut tasks = Vec::new();
    for records in records.chunk_by(|a, b| cube(*a) == cube(*b)).flat_map(|records| records.chunks(PER_TASK)) {
        let (own, others) = std::mem::take(&mut found).split_at_mut(records.len());
        tasks.push((records, own));
        found = others;
    }
    tasks
}

#[inline(always)]
fn index_of(record: u64) -> usize {
    (record & ((1 << INDEX_BITS) - 1)) as usize
}
