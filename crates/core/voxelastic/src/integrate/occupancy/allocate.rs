//! Allocation: uniform octants take the evidence of free space, and blocks are created or refined where voxels are needed.
//!
//! Most cells that a scan observes exist already. They are processed in parallel; cells that have to be created, which changes the tree, are left to one
//! thread.

use super::block_task::{BlockTask, FreeVoxels};
use super::evidence::Steps;
use super::free_cells::{BufferRange, FreeCell, FreeCells, OctantRef, clear};
use super::run_table::RunTable;
use crate::field::occupancy::propagate::ChangedOctants;
use crate::field::occupancy::{FlipKind, OccupancyField, SharedOctants, Summary};
use crate::integrate::rays::scale::{ScaleRule, distance_to_block};
use crate::integrate::rays::select::BlockRays;
use crate::octree::{BLOCK_EDGE, Cursor, NONE, block_coords, prefetch};
use rayon::prelude::*;

/// A selected block: where it was before the scan created or refined any, and its scale.
#[derive(Clone, Copy, Debug)]
struct SelectedBlock {
    octant: OctantRef,
    block: u32,
    /// The coarsest scale at which its rays may be integrated.
    scale: u8,
    /// Whether there is a block of that scale or finer.
    is_ready: bool,
}

/// The blocks that a scan updates, each once.
#[derive(Clone, Debug, Default)]
pub(super) struct BlockTasks {
    pub list: Vec<BlockTask>,
    /// The selected blocks, and which of them is which block.
    selected: Vec<SelectedBlock>,
    runs: RunTable,
    /// For each block, the index in `list` if the block was created or refined for free voxels in this scan; else any other number.
    created: Vec<u32>,
    /// Scratch memory of tasks.
    outputs: Vec<TaskOutput>,
}

/// What one task has processed, and the cells that it leaves to one thread, with their buffers.
#[derive(Clone, Debug, Default)]
struct TaskOutput {
    changed: ChangedOctants,
    tasks: Vec<BlockTask>,
    left: Vec<(u32, FreeCell)>,
}

/// Selected blocks of one task: few enough for an even load on all threads, many enough that the overhead of a task does not count.
const BLOCKS_PER_TASK: usize = 1024;

impl BlockTasks {
    /// Looks up the `selected` blocks, in parallel, because most are in no cache. `sensor` is the position of the sensor, metres.
    pub fn look_up(&mut self, field: &OccupancyField, selected: &[BlockRays], rule: &ScaleRule, voxel: f32, sensor: [f32; 3]) {
        let edge = BLOCK_EDGE as f32 * voxel;
        self.runs.reserve(field.blocks.capacity_used());
        self.selected.clear();
        self.selected.resize(selected.len(), SelectedBlock { octant: OctantRef::MISSING, block: NONE, scale: 0, is_ready: false });
        let (found, runs) = (&mut self.selected, &self.runs);
        found.par_chunks_mut(BLOCKS_PER_TASK).zip(selected.par_chunks(BLOCKS_PER_TASK)).enumerate().for_each(|(chunk, (found, selected))| {
            let mut cursor = Cursor::new(&field.tree);
            for (found, rays) in found.iter_mut().zip(selected) {
                let Some((group, index)) = cursor.find_at(&field.tree, rays.key, 0) else { continue };
                (found.octant, found.block) = (OctantRef::new((group, index)), field.tree.siblings(group)[index].link);
                if found.block != NONE {
                    prefetch(&raw const field.blocks[found.block]);
                }
            }
            for ((run, found), rays) in (chunk * BLOCKS_PER_TASK..).zip(found).zip(selected) {
                found.scale = rule.fitting(distance_to_block(block_coords(rays.key), edge, sensor)) as u8;
                if found.block != NONE {
                    found.is_ready = field.blocks[found.block].scale <= found.scale;
                    runs.set(found.block, run as u32);
                }
            }
        });
    }

    /// Adds the evidence of free space to uniform octants, and creates or refines the blocks that need voxels: those with free voxels, and those selected, which
    /// must have been [looked up](Self::look_up). Returns the octants that changed.
    pub fn allocate(&mut self, field: &mut OccupancyField, free: &FreeCells, selected: &[BlockRays], steps: &Steps) -> ChangedOctants {
        let mut changed = ChangedOctants::default();
        self.list.clear();
        let mut outputs = std::mem::take(&mut self.outputs);
        let used = self.process_existing(field, free, selected, steps, &mut outputs);
        for output in &outputs[..used] {
            changed.append(&output.changed);
            self.list.extend_from_slice(&output.tasks);
        }
        let mut cursor = Cursor::new(&field.tree);
        for (buffer, cell) in outputs[..used].iter().flat_map(|output| &output.left) {
            self.create_free(field, &mut cursor, (*buffer, cell), selected, steps, &mut changed);
        }
        self.create_selected(field, &mut cursor, selected);
        let used = self.add_remaining(selected, &mut outputs);
        outputs[..used].iter().for_each(|output| self.list.extend_from_slice(&output.tasks));
        self.outputs = outputs;
        changed
    }

    /// Processes the free cells that exist, in parallel; returns how many of `outputs` are used.
    fn process_existing(
        &self,
        field: &mut OccupancyField,
        free: &FreeCells,
        selected: &[BlockRays],
        steps: &Steps,
        outputs: &mut Vec<TaskOutput>,
    ) -> usize {
        /// As [`BLOCKS_PER_TASK`]; a range has about sixty cells.
        const RANGES_PER_TASK: usize = 32;
        /// How many cells ahead an octant or a block is prefetched.
        const AHEAD: usize = 8;
        let (octants, blocks) = (SharedOctants::new(&mut field.tree), &field.blocks);
        let process = |(ranges, output): (&[BufferRange], &mut TaskOutput)| {
            let all = ranges.iter().flat_map(|range| free.of(range).iter().map(|cell| (range.buffer, cell)));
            let mut ahead = all.clone().skip(AHEAD);
            output.clear();
            for (buffer, cell) in all {
                match ahead.next().map(|(_, next)| next) {
                    Some(next) if next.block != NONE => {
                        prefetch(&raw const blocks[next.block]);
                        prefetch(self.runs.address(next.block));
                    }
                    Some(next) if !next.octant.is_missing() => octants.prefetch(next.octant.position()),
                    _ => {}
                }
                match cell.block_update(buffer) {
                    None if !cell.octant.is_missing() => {
                        let at = cell.octant.position();
                        let (before, after) = (octants.summary(at), with_free_evidence(octants.summary(at), steps));
                        octants.set_summary(at, after);
                        output.changed.add(cell.key, cell.level());
                        output.changed.add_flip(cell.key, cell.level(), FlipKind::of(before.value, after.value));
                    }
                    Some((scale, free)) if cell.block != NONE && usize::from(blocks[cell.block].scale) <= scale => {
                        let run = self.runs.get(cell.block) as usize;
                        if self.selected.get(run).is_none_or(|selected| selected.is_ready) {
                            output.tasks.push(BlockTask::new(cell.block, cell.octant, free, selected.get(run)));
                            self.runs.set(cell.block, NONE);
                        } else {
                            output.left.push((buffer, *cell));
                        }
                    }
                    _ => output.left.push((buffer, *cell)),
                }
            }
        };
        let outputs = outputs_for(outputs, free.ranges.len(), RANGES_PER_TASK);
        free.ranges.par_chunks(RANGES_PER_TASK).zip(outputs.par_iter_mut()).for_each(process);
        outputs.len()
    }

    /// Creates the octant of a free cell, or creates or refines its block.
    fn create_free(
        &mut self,
        field: &mut OccupancyField,
        cursor: &mut Cursor,
        (buffer, cell): (u32, &FreeCell),
        selected: &[BlockRays],
        steps: &Steps,
        changed: &mut ChangedOctants,
    ) {
        let at = OctantRef::new(cursor.find_or_create_at(&mut field.tree, cell.key, cell.level()));
        let Some((scale, free)) = cell.block_update(buffer) else {
            let octant = &mut field.tree.siblings_mut(at.group)[at.index()];
            let before = octant.payload.value;
            octant.payload = with_free_evidence(octant.payload, steps);
            changed.add(cell.key, cell.level());
            changed.add_flip(cell.key, cell.level(), FlipKind::of(before, octant.payload.value));
            return;
        };
        let run = self.runs.take(cell.block) as usize;
        let scale = self.selected.get(run).map_or(scale, |selected| scale.min(selected.scale.into()));
        let block = field.find_or_create_in((at.group, at.index()), cell.key, scale);
        *self.created_mut(block) = self.list.len() as u32;
        self.list.push(BlockTask::new(block, at, free, selected.get(run)));
    }

    /// Creates or refines the selected blocks that are not ready.
    fn create_selected(&mut self, field: &mut OccupancyField, cursor: &mut Cursor, selected: &[BlockRays]) {
        for (found, rays) in self.selected.iter().zip(selected).filter(|(found, _)| !found.is_ready) {
            if found.block != NONE && self.runs.take(found.block) == NONE {
                continue; // Refined for its free voxels.
            }
            let at = if found.octant.is_missing() { OctantRef::new(cursor.find_or_create(&mut field.tree, rays.key)) } else { found.octant };
            let block = field.find_or_create_in((at.group, at.index()), rays.key, found.scale.into());
            let created = self.created.get(block as usize).and_then(|&index| self.list.get_mut(index as usize));
            match created.filter(|task| task.block == block) {
                Some(task) => (task.start, task.end) = (rays.start, rays.end),
                None => self.list.push(BlockTask::new(block, at, FreeVoxels::None, Some(rays))),
            }
        }
    }

    /// Adds the selected blocks that are ready and have no free voxels, in parallel; returns how many of `outputs` are used.
    fn add_remaining(&self, selected: &[BlockRays], outputs: &mut Vec<TaskOutput>) -> usize {
        let task = |(found, rays): (&SelectedBlock, &BlockRays)| {
            let is_left = found.is_ready && self.runs.take(found.block) != NONE;
            is_left.then(|| BlockTask::new(found.block, found.octant, FreeVoxels::None, Some(rays)))
        };
        let outputs = outputs_for(outputs, self.selected.len(), BLOCKS_PER_TASK);
        let chunks = self.selected.par_chunks(BLOCKS_PER_TASK).zip(selected.par_chunks(BLOCKS_PER_TASK));
        chunks.zip(outputs.par_iter_mut()).for_each(|((found, selected), output)| {
            clear(&mut output.tasks);
            output.tasks.extend(found.iter().zip(selected).filter_map(task));
        });
        outputs.len()
    }

    /// The entry of a block in `created`.
    #[inline(always)]
    fn created_mut(&mut self, block: u32) -> &mut u32 {
        let block = block as usize;
        if block >= self.created.len() {
            self.created.resize(block + 1, NONE);
        }
        &mut self.created[block]
    }
}

impl TaskOutput {
    fn clear(&mut self) {
        self.changed.clear();
        clear(&mut self.tasks);
        clear(&mut self.left);
    }
}

/// One output for each task that processes `per_task` of `count` items.
fn outputs_for(outputs: &mut Vec<TaskOutput>, count: usize, per_task: usize) -> &mut [TaskOutput] {
    let tasks = count.div_ceil(per_task);
    if outputs.len() < tasks {
        outputs.resize_with(tasks, TaskOutput::default);
    }
    &mut outputs[..tasks]
}

/// The summary of a uniform octant after evidence that it is free.
#[inline(always)]
fn with_free_evidence(summary: Summary, steps: &Steps) -> Summary {
    Summary::uniform(steps.add(summary.value, steps.free))
}
