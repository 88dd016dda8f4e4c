//! The parallel update of blocks: each block's evidence is collected from its free voxels and its rays, and applied once.

use super::apply::{BlockFrame, BlockOutcome, FreeMask, RayBatch, VoxelEvidence};
use super::block_task::{BlockTask, FreeVoxels};
use super::evidence::Steps;
use super::free_cells::FreeCells;
use super::settings::OccupancySettings;
use crate::field::BlockStoreMut;
use crate::field::occupancy::propagate::ChangedOctants;
use crate::field::occupancy::{OccupancyBlock, OccupancyField, Summary};
use crate::integrate::rays::ray::Ray;
use crate::integrate::rays::select::ray_of;
use crate::octree::{BLOCK_EDGE, NONE, Octant, Pool, block_coords, prefetch};
use crate::simd::Kernel;
use rayon::prelude::*;

/// What all threads need to update blocks.
pub(super) struct UpdateContext<'a> {
    pub blocks: &'a Pool<OccupancyBlock>,
    pub voxels: BlockStoreMut<'a, i8>,
    pub rays: &'a [Ray],
    /// See [`Selection::records`](crate::integrate::rays::select::Selection::records).
    pub records: &'a [u64],
    pub free: &'a FreeCells,
    pub settings: &'a OccupancySettings,
    pub steps: &'a Steps,
}

/// The blocks that one task updates, and what becomes of them.
pub(super) struct UpdateTask<'a> {
    /// Each block occurs once, over all tasks.
    pub blocks: &'a [BlockTask],
    pub outcomes: &'a mut [BlockOutcome],
    pub context: &'a UpdateContext<'a>,
}

impl Kernel for UpdateTask<'_> {
    #[inline(always)]
    fn run(self) {
        let Self { blocks, outcomes, context } = self;
        let (mut evidence, mut free_only) = (VoxelEvidence::new(context.steps), VoxelEvidence::new(context.steps));
        let mut batch = RayBatch::new(context.settings);
        let mut current = None;
        // Batches contain rays of one block after the other; blocks without rays are updated in between.
        for (number, task) in blocks.iter().enumerate() {
            if task.start == task.end {
                context.begin(task, &mut free_only);
                outcomes[number] = context.apply(task, &free_only);
                continue;
            }
            let frame = context.frame(task);
            for &record in &context.records[task.start as usize..task.end as usize] {
                batch.push(number as u32, frame, &context.rays[ray_of(record)]);
                if batch.is_full() {
                    context.add_batch(&mut batch, &mut evidence, &mut current, blocks, outcomes);
                }
            }
        }
        context.add_batch(&mut batch, &mut evidence, &mut current, blocks, outcomes);
        if let Some(last) = current {
            outcomes[last as usize] = context.apply(&blocks[last as usize], &evidence);
        }
    }
}

impl UpdateContext<'_> {
    #[inline(always)]
    fn frame(&self, task: &BlockTask) -> BlockFrame {
        let block = &self.blocks[task.block];
        let c = block_coords(block.key);
        let edge = BLOCK_EDGE as i32;
        BlockFrame { corner: [(c[0] * edge) as f32, (c[1] * edge) as f32, (c[2] * edge) as f32], scale: usize::from(block.scale) }
    }

    /// Starts a block with its free voxels.
    #[inline(always)]
    fn begin(&self, task: &BlockTask, evidence: &mut VoxelEvidence<'_>) {
        let free = match task.free {
            FreeVoxels::None => FreeMask::None,
            FreeVoxels::All => FreeMask::All,
            FreeVoxels::Mask { buffer, mask } => FreeMask::Some(&self.free.buffers[buffer as usize].masks[mask as usize]),
        };
        evidence.begin(usize::from(self.blocks[task.block].scale), free);
    }

    /// Adds the evidence of a batch. `current` is the block whose evidence is being collected; when the next block begins, it is applied.
    #[inline(always)]
    fn add_batch(
        &self,
        batch: &mut RayBatch<'_>,
        evidence: &mut VoxelEvidence<'_>,
        current: &mut Option<u32>,
        blocks: &[BlockTask],
        outcomes: &mut [BlockOutcome],
    ) {
        for lane in 0..batch.traverse() {
            let owner = batch.owner(lane);
            if *current != Some(owner) {
                if let Some(done) = *current {
                    outcomes[done as usize] = self.apply(&blocks[done as usize], evidence);
                }
                self.begin(&blocks[owner as usize], evidence);
                *current = Some(owner);
            }
            evidence.add(batch, lane);
        }
    }

    /// Applies the collected evidence to the voxels of a block.
    #[inline(always)]
    #[allow(unsafe_code)]
    fn apply(&self, task: &BlockTask, evidence: &VoxelEvidence<'_>) -> BlockOutcome {
        let block = &self.blocks[task.block];
        // SAFETY: each block occurs in one task only, and an array belongs to one block only.
        let values = unsafe { self.voxels.get(usize::from(block.scale), block.slot) };
        evidence.apply(usize::from(block.scale), values)
    }
}

/// Writes each block's summary to its octant, and removes the voxels of blocks that became uniform. Adds the octants to `changed`.
#[allow(unsafe_code)]
pub(super) fn write_outcomes(field: &mut OccupancyField, tasks: &[BlockTask], outcomes: &[BlockOutcome], changed: &mut ChangedOctants) {
    /// Few enough for an even load on all threads, many enough that the results are quickly joined.
    const BLOCKS_PER_TASK: usize = 4096;
    /// How many blocks ahead a block and its octant are prefetched.
    const AHEAD: usize = 8;
    let (octants, blocks) = (field.tree.disjoint_mut(), &field.blocks);
    let write = |(tasks, outcomes): (&[BlockTask], &[BlockOutcome])| {
        let (mut changed, mut uniform) = (ChangedOctants::default(), Vec::new());
        for (i, (task, outcome)) in tasks.iter().zip(outcomes).enumerate() {
            if let Some(next) = tasks.get(i + AHEAD) {
                prefetch(&raw const blocks[next.block]);
                prefetch(next.octant.within(&octants).address());
            }
            changed.add(blocks[task.block].key, 0);
            // SAFETY: each block occurs in one task only, and no reference to another octant of its group exists.
            let octant = unsafe { task.octant.within(&octants).get() };
            match outcome.uniform {
                Some(value) => {
                    *octant = Octant { link: NONE, payload: Summary::uniform(value) };
                    uniform.push(task.block);
                }
                None => octant.payload = outcome.summary,
            }
        }
        (changed, uniform)
    };
    let chunks = tasks.par_chunks(BLOCKS_PER_TASK).zip(outcomes.par_chunks(BLOCKS_PER_TASK));
    let parts: Vec<(ChangedOctants, Vec<u32>)> = chunks.map(write).collect();
    for (part, uniform) in parts {
        changed.append(&part);
        uniform.into_iter().for_each(|block| field.remove(block));
    }
}
