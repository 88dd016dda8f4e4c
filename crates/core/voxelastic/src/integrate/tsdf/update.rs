//! The voxel update of the TSDF: rays pass through blocks sixteen at a time, and the voxels of one batch are updated while those of the next are prefetched.
//!
//! Blocks come one after the other, each with its rays in ray order. While a batch is traversed ([`dda`](crate::integrate::rays::dda)), bricks that it meets are
//! decompressed or created, and their voxels prefetched.

use super::block_run::{ALL_OCTANTS, BlockRun, ScaleChange};
use super::rescale::change_scale;
use super::truncation::{LaneLabels, TruncationBand, UPDATE_CAPACITY, VoxelUpdates, has_intensity_at, observe_intensity};
use crate::field::tsdf::brick::{ADDRESS_BITS, BRICK, BRICKS};
use crate::field::tsdf::{Block, BlockWriter, BrickRef};
use crate::integrate::rays::dda::{LANES, Segment, SegmentLanes, Traversal};
use crate::integrate::rays::ray::Ray;
use crate::integrate::rays::select::ray_of;
use crate::octree::{BLOCK_EDGE, NONE, block_coords, prefetch_item};
use crate::simd::Kernel;

/// What all threads need to update blocks.
pub(super) struct UpdateContext<'a> {
    pub rays: &'a [Ray],
    /// See [`Selection::records`](crate::integrate::rays::select::Selection::records).
    pub records: &'a [u64],
    pub band: TruncationBand,
}

/// The blocks that one task updates.
pub(super) struct UpdateTask<'a, 'w> {
    pub runs: &'a [BlockRun],
    pub context: &'a UpdateContext<'a>,
    /// Has the blocks of `runs`, in their order.
    pub writer: &'a mut BlockWriter<'w>,
    pub buffers: &'a mut LaneBuffers,
}

/// Memory for two batches: one being filled and traversed, and the one before, whose voxels are updated. Too large to be allocated for every task.
pub(super) struct LaneBuffers([LaneBuffer; 2]);

impl LaneBuffers {
    pub fn new() -> Self {
        Self([LaneBuffer::new(), LaneBuffer::new()])
    }
}

/// How far ahead a ray is prefetched: records are in block order, rays in scan order.
const RAYS_AHEAD: usize = 24;
/// How far ahead a block is prefetched, and then its compressed bricks.
const BLOCKS_AHEAD: [usize; 2] = [6, 3];

impl Kernel for UpdateTask<'_, '_> {
    #[inline(always)]
    fn run(self) {
        let Self { runs, context, writer, buffers: LaneBuffers(buffers) } = self;
        let mut batches = buffers.each_mut().map(LaneBatch::new);
        let [mut filling, mut before] = batches.each_mut();
        // Loops, because a closure would not be inlined and then not be compiled for the wide instructions.
        for (i, run) in runs.iter().enumerate() {
            writer.prefetch_block(i + BLOCKS_AHEAD[0]);
            writer.prefetch_compressed(i + BLOCKS_AHEAD[1]);
            if run.change != ScaleChange::None {
                change_scale(writer, i, run.change, &context.band);
            }
            count_observations(writer.block_mut(i), run);
            let mut block = BlockContext::new(writer, i);
            for record in run.start as usize..run.end as usize {
                if let Some(&later) = context.records.get(record + RAYS_AHEAD) {
                    prefetch_item(&raw const context.rays[ray_of(later)]);
                }
                let ray = &context.rays[ray_of(context.records[record])];
                if !run.takes(ray.point, block.corner) {
                    continue;
                }
                filling.push(&block, ray);
                if filling.buffer.segments.len() == LANES {
                    if filling.traverse(before, &context.band, writer) {
                        block = BlockContext::new(writer, i);
                    }
                    std::mem::swap(&mut filling, &mut before);
                }
            }
        }
        filling.traverse(before, &context.band, writer);
        filling.apply_from(0, &context.band);
    }
}

/// The block that rays are being added for.
struct BlockContext<'w> {
    /// Its number among the blocks of the task.
    number: u32,
    scale: u32,
    /// Number of its first brick at its current scale, among all of its bricks.
    first: usize,
    /// The bricks at that scale.
    bricks: [BrickRef<'w>; BRICKS],
    has_intensity: bool,
    /// Its smallest corner, finest voxels.
    corner: [f32; 3],
}

/// Bits of a label: the number of the segment's block in its batch, whether that block has intensities, and the segment's lane.
const BLOCK_BIT: u32 = ADDRESS_BITS;
const INTENSITY_BIT: u32 = 15;
const LANE_BIT: u32 = 16;

/// The segments of a batch and the voxels that they pass.
struct LaneBuffer {
    segments: SegmentLanes,
    labels: LaneLabels,
    traversal: Traversal,
    updates: VoxelUpdates,
}

impl LaneBuffer {
    fn new() -> Self {
        Self {
            segments: SegmentLanes::new(),
            labels: LaneLabels { fine: [0; LANES], label: [0; LANES] },
            traversal: Traversal::new(),
            updates: VoxelUpdates::new(),
        }
    }
}

/// Up to sixteen rays that are traversed together, in one block or several.
struct LaneBatch<'b, 'w> {
    buffer: &'b mut LaneBuffer,
    /// The blocks of the batch: their numbers in the task, the numbers of their first bricks, and their bricks.
    numbers: [u32; LANES],
    firsts: [usize; LANES],
    bricks: [BrickRef<'w>; LANES * BRICKS],
    blocks: usize,
    /// Intensity of each ray.
    intensity: [u8; LANES],
    /// Number of returns in each ray.
    count: [f32; LANES],
}

impl<'b, 'w> LaneBatch<'b, 'w> {
    /// An empty batch.
    #[inline(always)]
    fn new(buffer: &'b mut LaneBuffer) -> Self {
        buffer.segments.clear();
        buffer.updates.len = 0;
        Self {
            buffer,
            numbers: [NONE; LANES],
            firsts: [0; LANES],
            bricks: [BrickRef::NOT_RESIDENT; LANES * BRICKS],
            blocks: 0,
            intensity: [0; LANES],
            count: [1.0; LANES],
        }
    }

    /// Adds the part of `ray` within `block`.
    #[inline(always)]
    fn push(&mut self, block: &BlockContext<'w>, ray: &Ray) {
        let lane = self.buffer.segments.len() % LANES;
        if self.blocks == 0 || self.numbers[(self.blocks - 1) % LANES] != block.number {
            let number = self.blocks % LANES;
            (self.numbers[number], self.firsts[number]) = (block.number, block.first);
            self.bricks[number * BRICKS..][..BRICKS].copy_from_slice(&block.bricks);
            self.blocks += 1;
        }
        (self.intensity[lane], self.count[lane]) = (ray.intensity, f32::from(ray.count));
        self.buffer.labels.fine[lane] = u32::from(block.scale == 0).wrapping_neg();
        self.buffer.labels.label[lane] =
            (lane as u32) << LANE_BIT | u32::from(block.has_intensity) << INTENSITY_BIT | (self.blocks as u32 - 1) << BLOCK_BIT;
        self.buffer.segments.push(&Segment {
            point: ray.point,
            direction: ray.direction,
            gradient: ray.normal,
            corner: block.corner,
            scale: block.scale,
            interval: [-ray.reach[0], ray.reach[1]],
        });
    }

    /// Collects the voxels that the segments pass and prefetches them, while the updates of the batch `before` are applied, which is then empty. Returns whether
    /// bricks were decompressed or created, so that a [`BlockContext`] made before is outdated.
    #[inline(always)]
    fn traverse(&mut self, before: &mut Self, band: &TruncationBand, writer: &mut BlockWriter<'w>) -> bool {
        let LaneBuffer { segments, labels, traversal, updates } = &mut *self.buffer;
        traversal.traverse(segments);
        band.collect(traversal, labels, updates);
        // Alternately: a thread that prefetches many lines of memory at once stalls until the first of them arrives.
        let count = updates.len;
        let both = count.min(before.buffer.updates.len);
        let mut has_new_bricks = false;
        for i in 0..both {
            has_new_bricks |= self.locate(i, band, writer);
            before.apply_update(i, band);
        }
        for i in both..count {
            has_new_bricks |= self.locate(i, band, writer);
        }
        before.apply_from(both, band);
        has_new_bricks
    }

    /// Finds the brick of update `i`, decompresses or creates it if necessary, and prefetches the voxel. Returns whether the brick is new in memory.
    #[inline(always)]
    fn locate(&mut self, i: usize, band: &TruncationBand, writer: &mut BlockWriter<'w>) -> bool {
        let update = self.buffer.updates.all[i % UPDATE_CAPACITY];
        let target = update.target();
        let (entry, voxel) = (brick_entry(target), target as usize % BRICK);
        if let Some(cells) = self.bricks[entry].cells() {
            cells.prefetch(voxel, has_intensity(target));
            return false;
        }
        if self.bricks[entry] == BrickRef::MISSING && !band.creates_voxel(update.distance()) {
            return false;
        }
        let block = (target >> BLOCK_BIT) as usize % LANES;
        self.bricks[entry] = writer.brick(self.numbers[block] as usize, self.firsts[block] + entry % BRICKS);
        true
    }

    /// Applies the updates from number `first` on and empties the batch.
    #[inline(always)]
    fn apply_from(&mut self, first: usize, band: &TruncationBand) {
        for i in first..self.buffer.updates.len {
            self.apply_update(i, band);
        }
        (self.buffer.updates.len, self.blocks) = (0, 0);
        self.buffer.segments.clear();
    }

    /// Applies update `i` to its voxel and the voxel's intensity. Does nothing where the brick is missing.
    #[inline(always)]
    fn apply_update(&mut self, i: usize, band: &TruncationBand) {
        let update = self.buffer.updates.all[i % UPDATE_CAPACITY];
        let (target, distance) = (update.target(), update.distance());
        let Some(cells) = self.bricks[brick_entry(target)].cells() else { return };
        let (index, lane) = (target as usize % BRICK, (target >> LANE_BIT) as usize % LANES);
        let weight = band.weight_at(distance) * self.count[lane];
        let mut voxel = cells.voxels[index].get();
        band.observe(distance, weight, &mut voxel);
        cells.voxels[index].set(voxel);
        if has_intensity(target) {
            let cell = &cells.intensities[index];
            let mut observed = cell.get();
            observe_intensity(&mut observed, self.intensity[lane]);
            // Branch-free: most voxels take an intensity, and which do is unpredictable.
            cell.set(if has_intensity_at(distance) { observed } else { cell.get() });
        }
    }
}

/// Index in a batch's `bricks` of the brick that contains the voxel `target`.
#[inline(always)]
fn brick_entry(target: u32) -> usize {
    (target / BRICK as u32) as usize % (LANES * BRICKS)
}

/// Whether the block of the voxel `target` has intensities.
#[inline(always)]
fn has_intensity(target: u32) -> bool {
    target >> INTENSITY_BIT & 1 == 1
}

impl<'w> BlockContext<'w> {
    /// The context of block number `i` of the task.
    #[inline(always)]
    fn new(writer: &BlockWriter<'w>, i: usize) -> Self {
        let block = writer.block(i);
        let corner = block_coords(block.key).map(|c| (c * BLOCK_EDGE as i32) as f32);
        let Block { scale, has_intensity, .. } = *block;
        Self { number: i as u32, scale: scale.into(), first: block.current().bricks().start, bricks: writer.bricks(i), has_intensity, corner }
    }
}

/// Adds the run's rays to the block's observation count, unless only some octants are updated.
#[inline(always)]
fn count_observations(block: &mut Block, run: &BlockRun) {
    if run.octant_mask == ALL_OCTANTS {
        block.observation_count = block.observation_count.plus(run.end - run.start);
    }
}
