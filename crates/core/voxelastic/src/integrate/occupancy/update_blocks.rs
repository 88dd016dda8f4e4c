//! The parallel update of blocks: each block's evidence is collected from its free voxels and its rays, and applied once.

use super::apply::{BlockFrame, BlockOutcome, FreeMask, RayBatch, VoxelEvidence};
use super::block_task::{BlockTask, FreeVoxels};
use super::evidence::Steps;
use super::free_cells::FreeCells;
use super::settings::OccupancySettings;
use crate::field::occupancy::propagate::ChangedOctants;
use crate::field::occupancy::{BlockWriter, OccupancyField, SharedOctants, Summary};
use crate::integrate::rays::ray::Ray;
use crate::integrate::rays::select::ray_of;
use crate::octree::{BLOCK_EDGE, NONE, block_coords, prefetch};
use crate::simd::Kernel;
use rayon::prelude::*;

/// What all threads need to update blocks.
pub(super) struct UpdateContext<'a> {
    pub rays: &'a [Ray],
    /// See [`Selection::records`](crate::integrate::rays::select::Selection::records).
    pub records: &'a [u64],
    pub free: &'a FreeCells,
    pub settings: &'a OccupancySettings,
    pub steps: &'a Steps,
}

/// The blocks that one task updates, and what becomes of them.
pub(super) struct UpdateTask<'a> {
    pub blocks: &'a [BlockTask],
    /// Write access to these blocks, in the same order.
    pub writer: BlockWriter<'a>,
    pub outcomes: &'a mut [BlockOutcome],
    pub context: &'a UpdateContext<'a>,
}

impl Kernel for UpdateTask<'_> {
    #[inline(always)]
    fn run(mut self) {
        let (blocks, context) = (self.blocks, self.context);
        let (mut evidence, mut free_only) = (VoxelEvidence::new(context.steps), VoxelEvidence::new(context.steps));
        let mut batch = RayBatch::new(context.settings);
        let mut current = None;
        // Batches contain rays of one block after the other; blocks without rays are updated in between.
        for (number, task) in blocks.iter().enumerate() {
            if task.start == task.end {
                self.begin(number, &mut free_only);
                self.apply(number, &free_only);
                continue;
            }
            let frame = self.frame(number);
            for &record in &context.records[task.start as usize..task.end as usize] {
                batch.push(number as u32, frame, &context.rays[ray_of(record)]);
                if batch.is_full() {
                    self.add_batch(&mut batch, &mut evidence, &mut current);
                }
            }
        }
        self.add_batch(&mut batch, &mut evidence, &mut current);
        if let Some(last) = current {
            self.apply(last as usize, &evidence);
        }
    }
}

impl UpdateTask<'_> {
    #[inline(always)]
    fn frame(&self, number: usize) -> BlockFrame {
        let block = self.writer.block(number);
        let c = block_coords(block.key);
        let edge = BLOCK_EDGE as i32;
        BlockFrame { corner: [(c[0] * edge) as f32, (c[1] * edge) as f32, (c[2] * edge) as f32], scale: usize::from(block.scale) }
    }

    /// Starts a block with its free voxels.
    #[inline(always)]
    fn begin(&self, number: usize, evidence: &mut VoxelEvidence<'_>) {
        let free = match self.blocks[number].free {
            FreeVoxels::None => FreeMask::None,
            FreeVoxels::All => FreeMask::All,
            FreeVoxels::Mask { buffer, mask } => FreeMask::Some(&self.context.free.buffers[buffer as usize].masks[mask as usize]),
        };
        evidence.begin(usize::from(self.writer.block(number).scale), free);
    }

    /// Adds the evidence of a batch. `current` is the block whose evidence is being collected; when the next block begins, it is applied.
    #[inline(always)]
    fn add_batch(&mut self, batch: &mut RayBatch<'_>, evidence: &mut VoxelEvidence<'_>, current: &mut Option<u32>) {
        for lane in 0..batch.traverse() {
            let owner = batch.owner(lane);
            if *current != Some(owner) {
                if let Some(done) = *current {
                    self.apply(done as usize, evidence);
                }
                self.begin(owner as usize, evidence);
                *current = Some(owner);
            }
            evidence.add(batch, lane);
        }
    }

    /// Applies the collected evidence to the voxels of a block.
    #[inline(always)]
    fn apply(&mut self, number: usize, evidence: &VoxelEvidence<'_>) {
        let scale = usize::from(self.writer.block(number).scale);
        self.outcomes[number] = evidence.apply(scale, self.writer.values_mut(number));
    }
}

/// Writes each block's summary to its octant, and removes the voxels of blocks that became uniform. Adds the octants to `changed`.
pub(super) fn write_outcomes(field: &mut OccupancyField, tasks: &[BlockTask], outcomes: &[BlockOutcome], changed: &mut ChangedOctants) {
    /// Few enough for an even load on all threads, many enough that the results are quickly joined.
    const BLOCKS_PER_TASK: usize = 4096;
    /// How many blocks ahead a block and its octant are prefetched.
    const AHEAD: usize = 8;
    let (octants, blocks) = (SharedOctants::new(&mut field.tree), &field.blocks);
    let write = |(tasks, outcomes): (&[BlockTask], &[BlockOutcome])| {
        let (mut changed, mut uniform) = (ChangedOctants::default(), Vec::new());
        for (i, (task, outcome)) in tasks.iter().zip(outcomes).enumerate() {
            if let Some(next) = tasks.get(i + AHEAD) {
                prefetch(&raw const blocks[next.block]);
                octants.prefetch(next.octant.position());
            }
            changed.add(blocks[task.block].key, 0);
            changed.add_flip(blocks[task.block].key, 0, outcome.flips);
            let at = task.octant.position();
            match outcome.uniform {
                Some(value) => {
                    octants.set_summary(at, Summary::uniform(value));
                    octants.set_link(at, NONE);
                    uniform.push(task.block);
                }
                None => octants.set_summary(at, outcome.summary),
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
