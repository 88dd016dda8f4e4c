//! The TSDFs of all submaps as one field that is brought up to date a few cubes at a time, while the map grows and bends.
//!
//! [`LiveField::note`] finds out which cubes are out of date, which costs little; [`LiveField::renew`] samples those that are asked for. Submaps lie where their poses are,
//! each bent as corrections moved its scans. They are not bent onto each other, because for that all of the map has to be looked at.

use super::alignment::{Corrections, Displacement, expected};
use super::one_field::{OneField, Reached, Source, sources};
use super::tsdf_sampling::{TargetBlock, displaced_target_blocks};
use crate::atlas::{Atlas, SubmapId};
use crate::field::tsdf::TsdfField;
use crate::geometry::Pose;
use crate::octree::{BLOCK_EDGE, MAX_BLOCK_COORD, block_coords, block_key};
use hashbrown::{HashMap, HashSet};
use rayon::prelude::*;

/// Key bits of a block within a cube: cubes have edges of eight blocks.
const CUBE_BITS: u32 = 9;
/// Edge of a cube, blocks.
const EDGE: i32 = 1 << (CUBE_BITS / 3);
/// Blocks per part: few, because few cubes are renewed at a time.
const BLOCKS_PER_PART: usize = 128;
/// A displacement differs by less than this within a block and its surroundings, finest voxels.
const DIFFERENCE: f32 = 1.0;

/// The map as one field.
#[derive(Debug, Default)]
pub(crate) struct LiveField {
    one: OneField,
    known: Vec<SourceState>,
    /// Cubes that are out of date.
    stale: HashSet<u64>,
    /// The blocks of the map that were sampled, by cube.
    made: HashMap<u64, Vec<u64>>,
}

/// A TSDF as it was when it was looked at last.
#[derive(Debug)]
struct SourceState {
    /// The submap, and whether it is being merged into another one.
    id: (SubmapId, bool),
    pose: Pose,
    corrected: Vec<Pose>,
    displacement: Displacement,
    clock: u32,
    revision: u64,
    /// Its blocks by the cubes of the map that they reach.
    cubes: HashMap<u64, Vec<u32>>,
    /// Number of blocks in them.
    blocks: u32,
}

impl LiveField {
    /// The field in the map frame. Cubes that were not renewed yet are as they were, or empty.
    pub fn field(&self) -> &TsdfField {
        &self.one.field
    }

    /// Whether a cube is out of date.
    pub fn is_stale(&self, cube: u64) -> bool {
        self.stale.contains(&cube)
    }

    /// The submap that has most blocks in a cube, of several the one with the lowest number.
    pub fn carrier(&self, cube: u64) -> Option<SubmapId> {
        let count = |state: &SourceState| Some((state.cubes.get(&cube)?.len(), std::cmp::Reverse(state.id.0)));
        self.known.iter().filter_map(count).max().map(|(_, id)| id.0)
    }

    /// Finds out what changed in the map. Returns the cubes up to `margin` blocks from what did, each once: at least those that are out of date now.
    pub fn note(&mut self, atlas: &Atlas, margin: i32) -> Vec<u64> {
        let (mut near, mut now) = (HashSet::new(), Vec::new());
        for source in sources(atlas) {
            let before = self.known.iter().position(|state| state.id == source.id).map(|i| self.known.swap_remove(i));
            let state = match before {
                Some(state) if state.is_of(&source) => self.grown(state, &source, margin, &mut near),
                before => {
                    let state = SourceState::new(&source);
                    let cubes = state.cubes.keys().chain(before.iter().flat_map(|before| before.cubes.keys()));
                    cubes.for_each(|cube| self.outdate(*cube, &mut near));
                    state
                }
            };
            now.push(state);
        }
        for gone in std::mem::replace(&mut self.known, now) {
            gone.cubes.into_keys().for_each(|cube| self.outdate(cube, &mut near));
        }
        near.into_iter().collect()
    }

    /// A cube is out of date as a whole.
    fn outdate(&mut self, cube: u64, near: &mut HashSet<u64>) {
        self.stale.insert(cube);
        near.insert(cube);
        near.extend(neighbours(cube));
    }

    /// The state of a source that scans may have changed.
    fn grown(&mut self, mut state: SourceState, source: &Source<'_>, margin: i32, near: &mut HashSet<u64>) -> SourceState {
        let clock = source.field.change_log.clock;
        if clock == state.clock {
            return state;
        }
        let changed: Vec<u32> = source.field.ids().filter(|id| source.field.block(*id).changed.wrapping_sub(state.clock) as i32 > 0).collect();
        state.add_blocks(source);
        // Samples in a block depend on what is a voxel of the scale around it.
        let coarsest = source.field.ids().map(|id| source.field.block(id).finest).max().unwrap_or(0);
        let around = (1u32 << coarsest) as f32;
        let reached = |id: &u32| [0, margin].map(|margin| cubes_of(source, &state.displacement, *id, around, margin));
        for [stale, beside] in changed.par_iter().with_min_len(256).map(reached).collect::<Vec<_>>() {
            self.stale.extend(stale);
            near.extend(beside);
        }
        (state.clock, state.revision) = (clock, source.revision);
        state
    }

    /// Samples those of some cubes that are out of date. The map is that of the last [`note`](Self::note).
    pub fn renew(&mut self, atlas: &Atlas, cubes: &[u64]) {
        let wanted: HashSet<u64> = cubes.iter().copied().filter(|cube| self.stale.remove(cube)).collect();
        if wanted.is_empty() {
            return;
        }
        let sources = sources(atlas);
        let reached =
            |source: &Source<'_>| self.known.iter().find(|state| state.id == source.id).map(|state| (state, state.reached(source, &wanted)));
        let reached: Vec<Option<(&SourceState, Vec<TargetBlock>)>> = sources.iter().map(reached).collect();
        let mut keys: Vec<u64> = reached.iter().flatten().flat_map(|(_, blocks)| blocks.iter().map(TargetBlock::key)).collect();
        let mut all: HashMap<u64, Vec<u64>> = wanted.iter().map(|cube| (*cube, Vec::new())).collect();
        keys.par_sort_unstable();
        keys.dedup();
        keys.iter().for_each(|key| all.entry(key >> CUBE_BITS).or_default().push(*key));
        // What nothing reaches any more becomes empty.
        keys.extend(wanted.iter().filter_map(|cube| self.made.get(cube)).flatten());
        keys.par_sort_unstable();
        keys.dedup();
        let mut all_reached: Vec<Reached<'_>> = Vec::new();
        for (source, reached) in sources.iter().zip(reached) {
            let Some((state, blocks)) = reached else { continue };
            let Source { field, placement, .. } = *source;
            all_reached.push(Reached { field, placement, displacement: &state.displacement, blocks: blocks.into() });
        }
        self.one.sample(&all_reached, &keys, BLOCKS_PER_PART);
        self.made.extend(all);
    }
}

impl SourceState {
    fn new(source: &Source<'_>) -> Self {
        let corrections = Corrections::new(source.submap, &source.pose);
        let mut state = Self {
            id: source.id,
            pose: source.pose,
            corrected: source.submap.corrected.clone(),
            displacement: expected(source.field, &source.placement, &corrections),
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

    /// Adds the blocks that are new. If scans were corrected, what is new is displaced, too.
    fn add_blocks(&mut self, source: &Source<'_>) {
        let new = self.blocks..source.field.ids().end;
        if self.blocks > 0 && !new.is_empty() && !self.corrected.is_empty() {
            self.displacement = expected(source.field, &source.placement, &Corrections::new(source.submap, &source.pose));
        }
        let reached: Vec<Vec<u64>> =
            new.clone().into_par_iter().with_min_len(256).map(|id| cubes_of(source, &self.displacement, id, 0.0, 0)).collect();
        for (id, cubes) in new.zip(reached) {
            cubes.into_iter().for_each(|cube| self.cubes.entry(cube).or_default().push(id));
        }
        self.blocks = source.field.ids().end;
    }

    /// The blocks in some cubes that the source reaches.
    fn reached(&self, source: &Source<'_>, cubes: &HashSet<u64>) -> Vec<TargetBlock> {
        let mut ids: Vec<u32> = cubes.iter().filter_map(|cube| self.cubes.get(cube)).flatten().copied().collect();
        ids.sort_unstable();
        ids.dedup();
        let all = displaced_target_blocks(source.field, &source.placement, &self.displacement, &ids, 0.0);
        all.iter().filter(|block| cubes.contains(&(block.key() >> CUBE_BITS))).copied().collect()
    }
}

/// The cubes of the map up to `margin` blocks from the blocks that are up to `around` finest voxels from what block `id` of a source reaches.
fn cubes_of(source: &Source<'_>, displacement: &Displacement, id: u32, around: f32, margin: i32) -> Vec<u64> {
    let half = 0.5 * BLOCK_EDGE as f32;
    let (middle, extent) =
        source.placement.box_in_target(block_coords(source.field.block(id).key).map(|c| c as f32 * BLOCK_EDGE as f32 + half), half);
    let (moved, spread) = (displacement.at(middle), if displacement.is_zero() { around } else { around + DIFFERENCE });
    let block = |k: usize, sign: f32| ((middle[k] + moved[k] + sign * (extent[k] + spread)) / BLOCK_EDGE as f32).floor() as i32;
    // Along each axis a block in each cube.
    let along = |k: usize| {
        let (low, high) = (block(k, -1.0) - margin, block(k, 1.0) + margin);
        (low..high).step_by(EDGE as usize).chain([high]).filter(|c| c.abs() < MAX_BLOCK_COORD)
    };
    let mut cubes: Vec<u64> = along(2).flat_map(|z| along(1).flat_map(move |y| along(0).map(move |x| block_key([x, y, z]) >> CUBE_BITS))).collect();
    cubes.sort_unstable();
    cubes.dedup();
    cubes
}

/// The cubes that touch a cube.
pub(crate) fn neighbours(cube: u64) -> impl Iterator<Item = u64> {
    let corner = block_coords(cube << CUBE_BITS);
    let around = (0..27)
        .filter(|i| *i != 13)
        .map(move |i| [corner[0] + EDGE * (i % 3 - 1), corner[1] + EDGE * (i / 3 % 3 - 1), corner[2] + EDGE * (i / 9 - 1)]);
    around.filter(|c| c.iter().all(|v| v.abs() < MAX_BLOCK_COORD)).map(|c| block_key(c) >> CUBE_BITS)
}
