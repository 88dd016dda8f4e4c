//! TSDF sampling: the source at the voxels of the target's lattice.
//!
//! Blocks of the target are worked on in cubes of 4 x 4 x 4. The source around a cube is a [`Window`]: bits that say around which of the
//! target's voxels anything is observed, and arrays that a kernel interpolates for those, sixteen at a time.

use super::decoded_blocks::DecodedBlocks;
use super::points::Points;
use super::sample_grid::{SampleGrid, base_and_fraction};
use super::sampled_block::{SampledBlock, WORDS, for_each_bit};
use super::select::Select;
use super::trilinear::{Group, Interpolate, Samples};
use super::window::{TargetBox, Window};
use crate::atlas::fusion::alignment::{CubeOffset, Displacement};
use crate::atlas::fusion::placement::Placement;
use crate::atlas::fusion::tsdf::TsdfPatch;
use crate::field::tsdf::{ObservationCount, TsdfField, Voxel};
use crate::octree::{BLOCK_EDGE, Cursor, MAX_BLOCK_COORD, SCALES, block_coords, block_key, voxel_coords, voxels_at};
use crate::simd::dispatch;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::Arc;

/// Key bits of a block within a cube of 4 x 4 x 4 blocks.
const CUBE_BITS: u32 = 6;
/// Edge of such a cube, blocks.
const CUBE_BLOCKS: usize = 4;
/// A displacement differs by less than this within a block and its surroundings, finest voxels.
const DIFFERENCE: f32 = 1.0;

/// A block of the target that the source reaches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TargetBlock {
    key: u64,
    /// The scale to sample at.
    scale: u8,
    /// Beams that observed the source there.
    observation_count: ObservationCount,
}

impl TargetBlock {
    /// Its Morton key in the target's lattice.
    pub fn key(&self) -> u64 {
        self.key
    }

    /// The scale to sample at.
    #[cfg(test)]
    pub fn scale(&self) -> usize {
        self.scale.into()
    }
}

/// Samples a field in the lattice of another one, part by part.
pub(crate) struct TsdfSampling<'a> {
    source: &'a TsdfField,
    placement: Placement,
    displacement: Displacement,
    blocks: Arc<[TargetBlock]>,
}

impl<'a> TsdfSampling<'a> {
    /// A sampling of `blocks`, which [`target_blocks`] found for the same source and placement, without a displacement.
    pub fn new(source: &'a TsdfField, placement: &Placement, blocks: Arc<[TargetBlock]>) -> Self {
        Self::displaced(source, placement, Displacement::default(), blocks)
    }

    /// As [`new`](Self::new), of a source that is displaced in the target.
    pub fn displaced(source: &'a TsdfField, placement: &Placement, displacement: Displacement, blocks: Arc<[TargetBlock]>) -> Self {
        Self { source, placement: *placement, displacement, blocks }
    }

    /// Number of blocks.
    pub fn len(&self) -> usize {
        self.blocks.len()
    }

    /// Blocks `range`, sampled.
    pub fn part(&self, range: Range<usize>) -> TsdfPatch {
        TsdfPatch::of(self.sample(range))
    }

    /// Samples those of the blocks `keys`, ascending, that the source reaches and where it is observed.
    pub fn sample_of(&self, keys: &[u64]) -> Vec<SampledBlock> {
        let (Some(first), Some(last)) = (keys.first(), keys.last()) else { return Vec::new() };
        let start = self.blocks.partition_point(|block| block.key < *first);
        let end = self.blocks.partition_point(|block| block.key <= *last);
        let mut next = 0;
        let is_wanted = |block: &&TargetBlock| {
            next += keys[next..].partition_point(|key| *key < block.key);
            keys.get(next) == Some(&block.key)
        };
        self.sample_blocks(&self.blocks[start..end].iter().filter(is_wanted).copied().collect::<Vec<_>>())
    }

    /// Samples blocks `range`; those without an observed voxel are left out. Each part decodes the blocks of the source that it needs: decoding
    /// the whole source would take as much memory as the samples.
    pub fn sample(&self, range: Range<usize>) -> Vec<SampledBlock> {
        self.sample_blocks(&self.blocks[range])
    }

    fn sample_blocks(&self, blocks: &[TargetBlock]) -> Vec<SampledBlock> {
        let mut sampler = Sampler::new(self.source, &self.placement, &self.displacement);
        let cubes = blocks.chunk_by(|a, b| a.key >> CUBE_BITS == b.key >> CUBE_BITS);
        cubes.flat_map(|cube| sampler.cube(cube)).collect()
    }
}

/// Samples the source cube by cube.
struct Sampler<'a> {
    placement: &'a Placement,
    displacement: &'a Displacement,
    /// Offsets in the present cube.
    offset: CubeOffset,
    cursor: Cursor,
    source: DecodedBlocks<'a>,
    windows: [Window; SCALES],
    /// Scales at which the windows are those of the present cube.
    filled: [bool; SCALES],
    grid: Box<SampleGrid>,
    points: Box<Points>,
    group: Box<Group>,
}

impl<'a> Sampler<'a> {
    fn new(source: &'a TsdfField, placement: &'a Placement, displacement: &'a Displacement) -> Self {
        Self {
            placement,
            displacement,
            offset: CubeOffset::default(),
            cursor: Cursor::new(source.tree()),
            source: DecodedBlocks::new(source),
            windows: Default::default(),
            filled: [false; SCALES],
            grid: Box::new(SampleGrid::new()),
            points: Box::new(Points::new()),
            group: Box::new(Group::new()),
        }
    }

    /// Samples blocks of the same cube.
    fn cube(&mut self, blocks: &[TargetBlock]) -> Vec<SampledBlock> {
        self.filled = [false; SCALES];
        let Some(first) = blocks.first() else { return Vec::new() };
        let low = block_coords(first.key >> CUBE_BITS << CUBE_BITS).map(|c| (c * BLOCK_EDGE as i32) as f32);
        self.offset = self.displacement.over(self.placement, low, (CUBE_BLOCKS * BLOCK_EDGE) as f32);
        let (offset, spread) = self.offset.mean_and_spread();
        let around = TargetBox { offset, spread, ..box_around(blocks) };
        blocks.iter().filter_map(|block| self.block(block, &around)).collect()
    }

    /// Fills the window at `scale`, unless it is.
    fn fill(&mut self, around: &TargetBox, scale: usize) {
        if !self.filled[scale] {
            self.windows[scale].fill(&mut self.source, &mut self.cursor, self.placement, around, scale);
            self.filled[scale] = true;
        }
    }

    /// Whether anything at `scale` or coarser is near block `key`.
    fn is_near(&self, key: u64, around: &TargetBox, scale: usize) -> bool {
        let (edge, half) = ((1 << scale) as f32, 0.5 * BLOCK_EDGE as f32);
        // The centres of its voxels.
        let centre = block_coords(key).map(|c| (c * BLOCK_EDGE as i32) as f32 + half);
        let (middle, extent) = self.placement.box_in_source(centre, half - 0.5 * edge);
        // Half a voxel from corners to centres, and some for rounding.
        let (middle, extent): ([f32; 3], [f32; 3]) = (std::array::from_fn(|k| middle[k] + around.offset[k]), extent.map(|v| v + around.spread));
        let low = std::array::from_fn(|k| ((middle[k] - extent[k]) / edge - 0.6).floor() as i32);
        let high = std::array::from_fn(|k| ((middle[k] + extent[k]) / edge - 0.4).floor() as i32);
        let window = &self.windows[scale];
        window.observed().any(low, high) || window.coarser().is_some_and(|cells| cells.any(low, high))
    }

    /// The voxels of a block of the target; none if none of them is observed.
    fn block(&mut self, block: &TargetBlock, around: &TargetBox) -> Option<SampledBlock> {
        let (scale, count) = (usize::from(block.scale), voxels_at(block.scale.into()));
        self.fill(around, scale);
        if !self.is_near(block.key, around, scale) {
            return None;
        }
        self.grid.fill(&self.placement.t_source_target, &self.offset, block.key, scale);
        let [mut observed, mut coarser] = [[0; WORDS]; 2];
        let window = &self.windows[scale];
        dispatch(Select { grid: &self.grid, count, cells: window.observed(), found: &mut observed });
        if let Some(cells) = window.coarser() {
            dispatch(Select { grid: &self.grid, count, cells, found: &mut coarser });
        }
        if (0..WORDS).all(|i| observed[i] | coarser[i] == 0) {
            return None;
        }
        let points = &mut *self.points;
        points.clear();
        for_each_bit(&std::array::from_fn(|i| observed[i] & !coarser[i]), |i| points.push(i, self.grid.at(i)));
        let mut voxels = vec![Voxel::default(); count].into_boxed_slice();
        let (mut intensities, mut has_intensity, mut observed) = (vec![0; count].into_boxed_slice(), false, [0; WORDS]);
        self.interpolate(
            scale,
            scale,
            Samples { voxels: &mut voxels, intensities: &mut intensities, observed: &mut observed, has_intensity: &mut has_intensity },
        );
        // Next to a coarser block: at the finest scale at which all interpolated samples exist; finer blocks contribute means.
        for at in scale + 1..SCALES {
            if coarser == [0; WORDS] {
                break;
            }
            self.fill(around, at);
            self.points.clear();
            coarser = self.select_at(block, coarser, at);
            self.interpolate(
                scale,
                at,
                Samples { voxels: &mut voxels, intensities: &mut intensities, observed: &mut observed, has_intensity: &mut has_intensity },
            );
        }
        let TargetBlock { key, scale, observation_count } = *block;
        let intensities = has_intensity.then_some(intensities);
        (observed != [0; WORDS]).then_some(SampledBlock { key, scale, observation_count, voxels, intensities, observed })
    }

    /// Adds those of the `pending` voxels of `block` around which anything is observed at scale `at` to the points. Returns those next to a still
    /// coarser block.
    fn select_at(&mut self, block: &TargetBlock, pending: [u64; WORDS], at: usize) -> [u64; WORDS] {
        let (scale, corner) = (usize::from(block.scale), block_coords(block.key).map(|c| (c * BLOCK_EDGE as i32) as f32));
        let edge = (1 << scale) as f32;
        let (window, points) = (&self.windows[at], &mut self.points);
        let mut coarser = [0; WORDS];
        for_each_bit(&pending, |i| {
            let c = voxel_coords(i, scale);
            let centre = std::array::from_fn(|k| corner[k] + (c[k] as f32 + 0.5) * edge);
            let (place, offset) = (self.placement.t_source_target.apply(centre), self.offset.at(centre));
            let (base, fraction) = base_and_fraction(std::array::from_fn(|k| place[k] + offset[k]), at);
            if window.coarser().is_some_and(|cells| cells.contains(base)) {
                coarser[i / 64] |= 1 << (i % 64);
            } else if window.observed().contains(base) {
                points.push(i, (base, fraction));
            }
        });
        coarser
    }

    /// Interpolates at the points, at scale `at`, for voxels of `scale`.
    fn interpolate(&mut self, scale: usize, at: usize, samples: Samples<'_>) {
        let points = &mut *self.points;
        if points.len() > 0 {
            points.fill_lanes();
            dispatch(Interpolate { cells: self.windows[at].cells(&self.source), points, scale, samples, group: &mut self.group });
        }
    }
}

/// The smallest box around blocks.
fn box_around(blocks: &[TargetBlock]) -> TargetBox {
    let [mut low, mut high] = [[i32::MAX; 3], [i32::MIN; 3]];
    for c in blocks.iter().map(|block| block_coords(block.key)) {
        for k in 0..3 {
            (low[k], high[k]) = (low[k].min(c[k]), high[k].max(c[k] + 1));
        }
    }
    let half = 0.5 * BLOCK_EDGE as f32;
    let centre = std::array::from_fn(|k| (low[k] + high[k]) as f32 * half);
    TargetBox { centre, half: std::array::from_fn(|k| (high[k] - low[k]) as f32 * half), ..TargetBox::default() }
}

/// The target's blocks that the source reaches, in Morton order. Scale and observation count are those of the source's block at the
/// target block's centre, otherwise those of the coarsest block that touches it.
pub(crate) fn target_blocks(field: &TsdfField, placement: &Placement) -> Arc<[TargetBlock]> {
    displaced_target_blocks(field, placement, &Displacement::default(), &field.ids().collect::<Vec<_>>())
}

/// As [`target_blocks`], of some blocks of a field that is displaced in the target.
pub(crate) fn displaced_target_blocks(field: &TsdfField, placement: &Placement, displacement: &Displacement, ids: &[u32]) -> Arc<[TargetBlock]> {
    let half = 0.5 * BLOCK_EDGE as f32;
    let spread = if displacement.is_zero() { 0.0 } else { DIFFERENCE };
    let touching = |&id: &u32| {
        let (scale, observation_count) = (field.block(id).finest, field.block(id).observation_count);
        let block = block_coords(field.block(id).key);
        let centre = block.map(|c| c as f32 * BLOCK_EDGE as f32 + half);
        let (middle, extent) = placement.box_in_target(centre, half);
        let moved = displacement.at(middle);
        let offset = placement.t_source_target.rotate(moved);
        let (middle, extent): ([f32; 3], [f32; 3]) = (std::array::from_fn(|k| middle[k] + moved[k]), extent.map(|v| v + spread));
        let low: [i32; 3] = std::array::from_fn(|k| ((middle[k] - extent[k]) / BLOCK_EDGE as f32).floor() as i32);
        let high: [i32; 3] = std::array::from_fn(|k| ((middle[k] + extent[k]) / BLOCK_EDGE as f32).floor() as i32);
        let mut found = Vec::new();
        for z in low[2]..=high[2] {
            for y in low[1]..=high[1] {
                for x in low[0]..=high[0] {
                    let c = [x, y, z];
                    let (at, reach) = placement.box_in_source(c.map(|v| v as f32 * BLOCK_EDGE as f32 + half), half);
                    let at: [f32; 3] = std::array::from_fn(|k| at[k] - offset[k]);
                    let is_outside = (0..3).any(|k| (at[k] - centre[k]).abs() > reach[k] + half + spread);
                    if !is_outside && c.iter().all(|v| v.abs() < MAX_BLOCK_COORD) {
                        let is_at_centre = at.map(|v| (v / BLOCK_EDGE as f32).floor() as i32) == block;
                        // Sorts the block at the centre first, then the coarsest.
                        let rank = if is_at_centre { 0 } else { SCALES as u8 - scale };
                        found.push((rank, TargetBlock { key: block_key(c), scale, observation_count }));
                    }
                }
            }
        }
        found
    };
    let mut blocks: Vec<(u8, TargetBlock)> = ids.par_iter().with_min_len(256).flat_map_iter(touching).collect();
    // All fields are compared: which block is kept must not depend on threads.
    blocks.par_sort_unstable_by_key(|(rank, block)| (block.key, *rank, block.scale, block.observation_count));
    blocks.dedup_by_key(|(_, block)| block.key);
    blocks.into_iter().map(|(_, block)| block).collect()
}
