//! The TSDFs of all submaps as one field that is brought up to date a few cubes at a time, while the map grows and bends.
//!
//! [`LiveField::note`] finds out which cubes are out of date, which costs little; [`LiveField::gather`] copies what those that are asked for are made of; and
//! [`SampledField::renew`](crate::atlas::fusion::SampledField::renew) samples them, on any thread. Submaps lie where their poses are, each bent as corrections moved its scans. They are
//! not bent onto each other, because for that all of the map has to be looked at.

use super::fused_tsdf::{Source, align, sources};
use super::sampled_field::{CUBE_SHIFT, Gathered, GatheredSource};
use crate::atlas::fusion::alignment::{Corrections, Displacement, expected};
use crate::atlas::{Atlas, SubmapId};
use crate::geometry::Pose;
use crate::octree::{BLOCK_EDGE, MAX_BLOCK_COORD, block_coords, cube_key, cube_place};
use hashbrown::{HashMap, HashSet};
use rayon::prelude::*;
use std::sync::Arc;

/// A displacement differs by less than this within a block and its surroundings, finest voxels.
const DIFFERENCE: f32 = 1.0;

/// What the map was when it was looked at last, and which cubes are out of date.
#[derive(Debug, Default)]
pub(crate) struct LiveField {
    known: Vec<SourceState>,
    /// Cubes that are out of date.
    stale: HashSet<u64>,
}

/// A TSDF as it was when it was looked at last.
#[derive(Debug)]
struct SourceState {
    /// The submap, and whether it is being merged into another one.
    id: (SubmapId, bool),
    pose: Pose,
    corrected: Vec<Pose>,
    displacement: Arc<Displacement>,
    clock: u32,
    revision: u64,
    /// Its blocks by the cubes of the map that they reach.
    cubes: HashMap<u64, Vec<u32>>,
    /// Number of blocks in them.
    blocks: u32,
}

/// Cubes of two sizes around what changed.
#[derive(Default)]
struct Changed {
    /// Cubes that are out of date.
    stale: HashSet<u64>,
    /// Those with edges of 2^`shift` blocks that have blocks up to `margin` blocks away.
    near: HashSet<u64>,
    margin: i32,
    shift: u32,
    recent: [RecentRanges; 2],
}

/// Ranges of cubes that were met recent: blocks side by side mostly reach the same ones.
struct RecentRanges(Vec<CubeRange>);

/// Cubes of one size, by the lowest and the highest along each axis; none if the lowest is above the highest. They are counted as in their keys.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct CubeRange([[u32; 3]; 2]);

impl LiveField {
    /// Whether a cube is out of date.
    pub fn is_stale(&self, cube: u64) -> bool {
        self.stale.contains(&cube)
    }

    /// The submaps that have blocks in some cubes, and how many: the same submap may come several times.
    pub fn parts(&self, cubes: impl Iterator<Item = u64> + Clone) -> impl Iterator<Item = (SubmapId, usize)> {
        self.known.iter().flat_map(move |state| cubes.clone().filter_map(|cube| Some((state.id.0, state.cubes.get(&cube)?.len()))))
    }

    /// Finds out what changed in the map. Returns the cubes with edges of 2^`shift` blocks that have blocks up to `margin` blocks from what is out of date now and was not
    /// before, each once.
    pub fn note(&mut self, atlas: &Atlas, shift: u32, margin: i32) -> HashSet<u64> {
        let (mut changed, mut now) = (Changed { shift, margin, ..Changed::default() }, Vec::new());
        for source in sources(atlas) {
            let before = self.known.iter().position(|state| state.id == source.id).map(|i| self.known.swap_remove(i));
            let state = match before {
                Some(state) if state.is_of(&source) => state.grown(&source, &mut changed),
                before => {
                    let state = SourceState::new(&source);
                    state.cubes.keys().chain(before.iter().flat_map(|before| before.cubes.keys())).for_each(|cube| changed.add(*cube));
                    state
                }
            };
            now.push(state);
        }
        for gone in std::mem::replace(&mut self.known, now) {
            gone.cubes.into_keys().for_each(|cube| changed.add(cube));
        }
        self.stale.extend(changed.stale);
        changed.near
    }

    /// Bends the submaps onto each other, as they were noted last, until one of them moves. Returns cubes as [`note`](Self::note) does.
    pub fn settle(&mut self, atlas: &Atlas, shift: u32, margin: i32) -> HashSet<u64> {
        let (all, mut changed) = (sources(atlas), Changed { shift, margin, ..Changed::default() });
        let displacements = if all.len() < 2 { Vec::new() } else { align(&all).0 };
        for (source, displacement) in all.iter().zip(displacements) {
            let Some(state) = self.known.iter_mut().find(|state| state.id == source.id) else { continue };
            if displacement != *state.displacement {
                state.cubes.keys().for_each(|cube| changed.add(*cube));
                (state.displacement, state.cubes, state.blocks) = (Arc::new(displacement), HashMap::new(), 0);
                state.add_blocks(source);
                state.cubes.keys().for_each(|cube| changed.add(*cube));
            }
        }
        self.stale.extend(changed.stale);
        changed.near
    }

    /// Copies what those of some cubes that are out of date are made of; they are not out of date any more. The map is that of the last [`note`](Self::note).
    pub fn gather(&mut self, atlas: &Atlas, cubes: &HashSet<u64>) -> Gathered {
        let mut wanted: Vec<u64> = cubes.iter().copied().filter(|cube| self.stale.remove(cube)).collect();
        wanted.sort_unstable();
        // Samples depend on what is up to two voxels of the coarsest scale away, and on a displacement there: less than a cube.
        let mut around: Vec<u64> = wanted.iter().flat_map(|cube| cubes_around(*cube, CUBE_SHIFT)).collect();
        around.sort_unstable();
        around.dedup();
        let gathered = |source: &Source<'_>| self.known.iter().find(|state| state.id == source.id)?.gathered(source, &wanted, &around);
        Gathered { sources: sources(atlas).par_iter().filter_map(gathered).collect(), cubes: wanted }
    }
}

impl Changed {
    /// A cube is out of date as a whole.
    fn add(&mut self, cube: u64) {
        if self.stale.insert(cube) {
            let low = block_coords(cube << (3 * CUBE_SHIFT));
            self.near.extend(cubes_between(low, low.map(|c| c + (1 << CUBE_SHIFT) - 1), self.margin, self.shift));
        }
    }

    /// What the blocks between two reach is out of date.
    fn add_between(&mut self, low: [i32; 3], high: [i32; 3]) {
        let (stale, near) = (CubeRange::new(low, high, 0, CUBE_SHIFT), CubeRange::new(low, high, self.margin, self.shift));
        if self.recent[0].is_new(stale) {
            self.stale.extend(stale.keys());
        }
        if self.recent[1].is_new(near) {
            self.near.extend(near.keys());
        }
    }
}

impl Default for RecentRanges {
    fn default() -> Self {
        Self(vec![CubeRange::NONE; 1 << Self::BITS])
    }
}

impl RecentRanges {
    const BITS: u32 = 8;

    /// Whether a range is another one than the last in its place.
    fn is_new(&mut self, range: CubeRange) -> bool {
        let [[x, y, z], _] = range.0;
        let hash = x.wrapping_mul(0x9e37_79b1) ^ y.wrapping_mul(0x85eb_ca6b) ^ z.wrapping_mul(0xc2b2_ae35);
        let place = &mut self.0[(hash >> (32 - Self::BITS)) as usize];
        std::mem::replace(place, range) != range
    }
}

impl CubeRange {
    const NONE: Self = Self([[1; 3], [0; 3]]);

    /// Cubes with edges of 2^`shift` blocks up to `margin` blocks from the blocks between two.
    fn new(low: [i32; 3], high: [i32; 3], margin: i32, shift: u32) -> Self {
        if (0..3).any(|k| high[k] <= -MAX_BLOCK_COORD || low[k] >= MAX_BLOCK_COORD) {
            return Self::NONE;
        }
        let bound = |c: i32| c.clamp(1 - MAX_BLOCK_COORD, MAX_BLOCK_COORD - 1);
        Self([cube_place(low.map(|c| bound(c - margin)), shift), cube_place(high.map(|c| bound(c + margin)), shift)])
    }

    /// The keys of the cubes.
    pub fn keys(self) -> impl Iterator<Item = u64> {
        let [low, high] = self.0;
        let along = move |k: usize| low[k]..high[k] + 1;
        along(2).flat_map(move |z| along(1).flat_map(move |y| along(0).map(move |x| cube_key([x, y, z]))))
    }
}

impl SourceState {
    fn new(source: &Source<'_>) -> Self {
        let corrections = Corrections::new(source.submap, &source.pose);
        let mut state = Self {
            id: source.id,
            pose: source.pose,
            corrected: source.submap.corrected.clone(),
            displacement: Arc::new(expected(source.field, &source.placement, &corrections)),
            clock: source.field.change_log.clock,
            revision: source.revision,
            cubes: HashMap::new(),
            blocks: 0,
        };
        state.add_blocks(source);
        state
    }

    /// Whether nothing but scans changed the source since.
    fn is_of(&self, source: &Source<'_>) -> bool {
        self.pose == source.pose && self.corrected == source.submap.corrected && !source.was_merged_since(self.revision, self.clock)
    }

    /// The state of a source that scans may have changed since.
    fn grown(mut self, source: &Source<'_>, found: &mut Changed) -> Self {
        let log = &source.field.change_log;
        if log.clock == self.clock {
            return self;
        }
        // The log has all that the last scan changed; of earlier ones a part may be gone.
        let changed: Vec<u32> = match log.changes.back() {
            Some((clock, ids)) if log.clock.wrapping_sub(self.clock) == 1 && *clock == log.clock => ids.clone(),
            _ => source.field.ids().filter(|id| source.field.block(*id).changed.wrapping_sub(self.clock) as i32 > 0).collect(),
        };
        self.add_blocks(source);
        // Samples in a block depend on what is a voxel of the scale around it.
        let coarsest = changed.iter().map(|id| source.field.block(*id).finest).max().unwrap_or(0);
        let around = (1u32 << coarsest) as f32;
        for id in changed {
            let (low, high) = blocks_of(source, &self.displacement, id, around);
            found.add_between(low, high);
        }
        (self.clock, self.revision) = (log.clock, source.revision);
        self
    }

    /// Adds the blocks that are new. If scans were corrected, what is new is displaced, too.
    fn add_blocks(&mut self, source: &Source<'_>) {
        let new = self.blocks..source.field.ids().end;
        if self.blocks > 0 && !new.is_empty() && !self.corrected.is_empty() {
            self.displacement = Arc::new(expected(source.field, &source.placement, &Corrections::new(source.submap, &source.pose)));
        }
        let ranges = |id| {
            let (low, high) = blocks_of(source, &self.displacement, id, 0.0);
            CubeRange::new(low, high, 0, CUBE_SHIFT)
        };
        let ranges: Vec<CubeRange> = new.clone().into_par_iter().with_min_len(4096).map(ranges).collect();
        for (id, range) in new.zip(ranges) {
            range.keys().for_each(|cube| self.cubes.entry(cube).or_default().push(id));
        }
        self.blocks = source.field.ids().end;
    }

    /// What the source has in cubes `wanted`, of which it must reach one, and `around` them.
    fn gathered(&self, source: &Source<'_>, wanted: &[u64], around: &[u64]) -> Option<GatheredSource> {
        let blocks = |cubes: &[u64]| {
            let mut ids: Vec<u32> = cubes.iter().filter_map(|cube| self.cubes.get(cube)).flatten().copied().collect();
            ids.sort_unstable();
            ids.dedup();
            ids
        };
        let reached = blocks(wanted);
        if reached.is_empty() {
            return None;
        }
        let all = blocks(around);
        let reached = reached.iter().filter_map(|id| Some(all.binary_search(id).ok()? as u32)).collect();
        let (placement, displacement) = (source.placement, Arc::clone(&self.displacement));
        Some(GatheredSource { field: source.field.excerpt(&all), placement, displacement, reached })
    }
}

/// The blocks of the map, lowest and highest, that are up to `around` finest voxels from what block `id` of a source reaches.
fn blocks_of(source: &Source<'_>, displacement: &Displacement, id: u32, around: f32) -> ([i32; 3], [i32; 3]) {
    let half = 0.5 * BLOCK_EDGE as f32;
    let (middle, extent) =
        source.placement.box_in_target(block_coords(source.field.block(id).key).map(|c| c as f32 * BLOCK_EDGE as f32 + half), half);
    let (moved, spread) = (displacement.at(middle), if displacement.is_zero() { around } else { around + DIFFERENCE });
    let block = |sign: f32| std::array::from_fn(|k| ((middle[k] + moved[k] + sign * (extent[k] + spread)) / BLOCK_EDGE as f32).floor() as i32);
    (block(-1.0), block(1.0))
}

/// The cubes with edges of 2^`shift` blocks up to `margin` blocks from the blocks between two.
pub(crate) fn cubes_between(low: [i32; 3], high: [i32; 3], margin: i32, shift: u32) -> impl Iterator<Item = u64> {
    CubeRange::new(low, high, margin, shift).keys()
}

/// A cube with an edge of 2^`shift` blocks and those that touch it.
pub(crate) fn cubes_around(cube: u64, shift: u32) -> impl Iterator<Item = u64> {
    let low = block_coords(cube << (3 * shift));
    cubes_between(low, low.map(|c| c + (1 << shift) - 1), 1, shift)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::octree::block_key;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn cubes_around_blocks_are_those_that_have_blocks_there() {
        for (shift, margin) in [(1, 0), (2, 1), (2, 5), (3, 2), (3, 8)] {
            for (low, high) in [([-3, 0, 5], [-3, 0, 5]), ([-9, -2, 1], [-4, 7, 3]), ([2, 1, -1], [3, 2, 0])] {
                let mut expected: Vec<u64> = Vec::new();
                for z in low[2] - margin..=high[2] + margin {
                    for y in low[1] - margin..=high[1] + margin {
                        expected.extend((low[0] - margin..=high[0] + margin).map(|x| block_key([x, y, z]) >> (3 * shift)));
                    }
                }
                let mut found: Vec<u64> = cubes_between(low, high, margin, shift).collect();
                found.sort_unstable();
                expected.sort_unstable();
                expected.dedup();
                assert_eq!(found, expected, "{shift} {margin} {low:?}");
            }
        }
        let middle = block_key([17, -4, 2]) >> 9;
        assert!(cubes_around(middle, 3).count() == 27 && cubes_around(middle, 3).any(|cube| cube == middle));
        assert_eq!(cubes_between([i32::MIN / 2; 3], [i32::MIN / 2 + 1; 3], 2, 3).count(), 0);
    }

    /// What is kept of ranges that were met lately leaves nothing out.
    #[test]
    fn what_blocks_reach_is_found_whole() {
        let mut random = rand::rngs::StdRng::seed_from_u64(5);
        let (mut changed, mut expected) = (Changed { shift: 3, margin: 2, ..Changed::default() }, Changed::default());
        for _ in 0..3000 {
            let low: [i32; 3] = std::array::from_fn(|_| random.random_range(-60..60));
            let high = low.map(|c| c + random.random_range(0..3));
            changed.add_between(low, high);
            expected.stale.extend(cubes_between(low, high, 0, CUBE_SHIFT));
            expected.near.extend(cubes_between(low, high, 2, 3));
        }
        assert_eq!((changed.stale, changed.near), (expected.stale, expected.near));
    }
}
