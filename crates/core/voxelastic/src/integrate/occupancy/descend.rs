//! Map-to-sensor descent (paper Sec. III-A): finds the octants, from the root down, that are wholly in free space.
//!
//! The descent only reads the map, so it runs in parallel over subtrees. Within a subtree it visits all cubes of one size before the next smaller ones, so that
//! many are classified together. It stops at octants that are free, that contain nothing free, that are saturated free already (surfaces are found by walking
//! rays, so these octants cannot change), or that are no larger than the spacing of the rays. The result is a list of [`FreeCell`](super::free_cells::FreeCell)s
//! in Morton order.

use super::classify::{Classes, Classifier, ClassifyScratch, bits};
use super::cube::{Cube, children_to_refine, min_width};
use super::evidence::Steps;
use super::free_cells::{BufferRange, FreeCells, FreeExtent, Mask, OctantRef, ThreadBuffer, coarsest_scale, set_cube};
use super::settings::OccupancySettings;
use crate::field::occupancy::OccupancyField;
use crate::octree::{BLOCK_EDGE, NONE, block_coords, prefetch_item};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// How many cubes ahead the octants below one are prefetched.
const AHEAD: usize = 4;

/// The input of a descent.
pub(super) struct Descent<'a> {
    pub field: &'a OccupancyField,
    pub classifier: Classifier<'a>,
    pub settings: &'a OccupancySettings,
    pub steps: Steps,
}

/// A block of which only a part may be free.
#[derive(Clone, Copy, Debug)]
struct PartialBlock {
    block: Cube,
    mask: Mask,
    /// The finest scale at which free voxels are distinguished.
    finest: usize,
    /// Width of a cube of half the block's edge, in rays.
    rays: f32,
}

/// A cube in a partial block whose children are classified: the block itself, half its edge or a quarter.
#[derive(Clone, Copy, Debug)]
struct BlockPart {
    /// Index in the list of partial blocks.
    block: u32,
    /// Index among the block's cubes of this size, in Morton order.
    index: usize,
}

/// Scratch memory of one thread, kept from scan to scan.
#[derive(Clone, Debug)]
pub(super) struct DescentScratch {
    classify: ClassifyScratch,
    centres: Vec<[f32; 3]>,
    classes: Vec<Classes>,
    cubes: Vec<Cube>,
    children: Vec<Cube>,
    stack: Vec<Cube>,
    partial: Vec<PartialBlock>,
    parts: Vec<BlockPart>,
    smaller: Vec<BlockPart>,
    smaller_centres: Vec<[f32; 3]>,
}

impl DescentScratch {
    fn new() -> Self {
        Self {
            classify: ClassifyScratch::new(),
            centres: Vec::new(),
            classes: Vec::new(),
            cubes: Vec::new(),
            children: Vec::new(),
            stack: Vec::new(),
            partial: Vec::new(),
            parts: Vec::new(),
            smaller: Vec::new(),
            smaller_centres: Vec::new(),
        }
    }
}

impl Descent<'_> {
    /// Finds the free cells of the field, whose root must cover everything within the scan's reach.
    pub fn run(&self, scratches: &mut Vec<Box<DescentScratch>>, free: &mut FreeCells) {
        let tree = &self.field.tree;
        let root = Cube {
            key: tree.root_key(),
            corner: block_coords(tree.root_key()),
            level: tree.root_level() as u8,
            octant: OctantRef::MISSING,
            link: tree.root().link,
            summary: tree.root().payload,
            free: false,
            crossed: false,
            min_width: 0,
        };
        let subtrees = self.subtrees(root, scratches);
        free.buffers.resize_with(scratches.len(), ThreadBuffer::default);
        free.buffers.iter_mut().for_each(ThreadBuffer::clear);
        // Scratch memory and buffers are handed from subtree to subtree. Subtrees are not equal work, so any thread may take the next one.
        let created = AtomicU32::new(scratches.len() as u32);
        let spare = Mutex::new((0..).zip(scratches.drain(..).zip(free.buffers.drain(..))).collect::<Vec<_>>());
        let descend = |&root: &Cube| {
            let reused = lock(&spare).pop();
            let create = || (created.fetch_add(1, Ordering::Relaxed), (Box::new(DescentScratch::new()), ThreadBuffer::default()));
            let (number, (mut scratch, mut buffer)) = reused.unwrap_or_else(create);
            let start = buffer.cells.len() as u32;
            self.descend(root, &mut scratch, &mut buffer);
            let end = buffer.cells.len() as u32;
            lock(&spare).push((number, (scratch, buffer)));
            BufferRange { buffer: number, start, end }
        };
        subtrees.par_iter().with_max_len(1).map(descend).collect_into_vec(&mut free.ranges);
        let mut all = std::mem::take(&mut *lock(&spare));
        all.sort_unstable_by_key(|(number, _)| *number);
        (*scratches, free.buffers) = all.into_iter().map(|(_, both)| both).unzip();
    }

    /// Divides the tree into subtrees of about equal work.
    fn subtrees(&self, root: Cube, scratches: &mut Vec<Box<DescentScratch>>) -> Vec<Cube> {
        let mut scratch = scratches.pop().unwrap_or_else(|| Box::new(DescentScratch::new()));
        let mut subtrees = vec![root];
        loop {
            // All of them are equally large: those of earlier rounds that are smaller are not divided.
            let large: Vec<Cube> = subtrees.iter().copied().filter(|cube| self.is_too_much_work(cube)).collect();
            if large.is_empty() {
                scratches.push(scratch);
                return subtrees;
            }
            self.classify_children(&large, &mut scratch);
            let mut classes = scratch.classes.iter();
            let mut smaller = Vec::new();
            for cube in &subtrees {
                match classes.as_slice().first() {
                    Some(first) if self.is_too_much_work(cube) => {
                        classes.next();
                        self.push_children(cube, first, |child| smaller.push(child));
                    }
                    _ => smaller.push(*cube),
                }
            }
            subtrees = smaller;
        }
    }

    /// Whether a subtree is too much work for one task. Cubes are refined to the spacing of the rays, which grows with the range, so cubes of equal angular size
    /// are about equal work.
    fn is_too_much_work(&self, cube: &Cube) -> bool {
        const LARGEST: u32 = 5;
        let (centre, half) = self.centre_and_half(cube);
        cube.level() > LARGEST || (cube.level > 1 && 2.0 * half > self.classifier.range(centre))
    }

    /// Classifies the children of `cubes`, which must be equally large.
    fn classify_children(&self, cubes: &[Cube], scratch: &mut DescentScratch) {
        scratch.centres.clear();
        scratch.centres.extend(cubes.iter().map(|cube| self.centre_and_half(cube).0));
        let half = cubes.first().map_or(0.0, |cube| self.centre_and_half(cube).1);
        self.classifier.classify(&scratch.centres, half, &mut scratch.classify, &mut scratch.classes);
    }

    /// Pushes the children that may contain something free and are not saturated free, in Morton order.
    fn push_children(&self, cube: &Cube, classes: &Classes, mut push: impl FnMut(Cube)) {
        let (free, level) = (if cube.free { u8::MAX } else { classes.free }, cube.level - 1);
        let siblings = (cube.link != NONE).then(|| self.field.tree.siblings(cube.link));
        for i in bits(free | classes.mixed) {
            let (link, summary) = siblings.map_or((NONE, cube.summary), |siblings| (siblings[i].link, siblings[i].payload));
            if !summary.is_saturated_free(self.steps.min) {
                let (key, corner) = cube.child(i);
                push(Cube {
                    key,
                    corner,
                    level,
                    octant: if cube.link == NONE { OctantRef::MISSING } else { OctantRef::new((cube.link, i)) },
                    link,
                    summary,
                    free: free >> i & 1 == 1,
                    crossed: classes.crossed >> i & 1 == 1,
                    min_width: min_width(classes, i),
                });
            }
        }
    }

    /// Prefetches the octants below a cube.
    #[inline(always)]
    fn prefetch_children(&self, cube: Option<&Cube>) {
        if let Some(cube) = cube.filter(|cube| cube.link != NONE) {
            prefetch_item(&raw const *self.field.tree.siblings(cube.link));
        }
    }

    /// Centre and half the edge of a cube, metres, submap frame.
    #[inline(always)]
    fn centre_and_half(&self, cube: &Cube) -> ([f32; 3], f32) {
        let edge = BLOCK_EDGE as f32 * self.settings.voxel_size;
        let half = 0.5 * (1u32 << cube.level) as f32;
        let middle = |k: usize| (cube.corner[k] as f32 + half) * edge;
        ([middle(0), middle(1), middle(2)], half * edge)
    }

    /// Finds the free cells below `root`, visiting all cubes of one size before the next smaller ones.
    fn descend(&self, root: Cube, scratch: &mut DescentScratch, buffer: &mut ThreadBuffer) {
        let start = buffer.cells.len();
        scratch.cubes.clear();
        scratch.partial.clear();
        self.collect_or_queue(root, scratch, buffer);
        std::mem::swap(&mut scratch.cubes, &mut scratch.children);
        while !scratch.cubes.is_empty() {
            let cubes = std::mem::take(&mut scratch.cubes);
            self.classify_children(&cubes, scratch);
            buffer.visited += 8 * cubes.len();
            let classes = std::mem::take(&mut scratch.classes);
            for (i, (cube, classes)) in cubes.iter().zip(&classes).enumerate() {
                self.prefetch_children(cubes.get(i + AHEAD));
                self.push_children(cube, classes, |child| self.collect_or_queue(child, scratch, buffer));
            }
            (scratch.cubes, scratch.classes) = (cubes, classes);
            scratch.cubes.clear();
            std::mem::swap(&mut scratch.cubes, &mut scratch.children);
        }
        self.refine_blocks(scratch, buffer);
        // From lists by size to one list in Morton order.
        let cells = &mut buffer.cells[start..];
        cells.sort_unstable_by_key(|cell| cell.key);
        buffer.octants += cells.iter().filter(|cell| matches!(cell.extent, FreeExtent::Octant { .. })).count();
    }

    /// Collects all free cells of a free cube, or queues a mixed one for refinement.
    fn collect_or_queue(&self, cube: Cube, scratch: &mut DescentScratch, buffer: &mut ThreadBuffer) {
        if !cube.free {
            if cube.level > 0 {
                scratch.children.push(cube);
            } else {
                self.queue_block(cube, scratch, buffer);
            }
            return;
        }
        let stack = &mut scratch.stack;
        stack.push(cube);
        while let Some(cube) = stack.pop() {
            if cube.link == NONE {
                buffer.cells.push(cube.free_cell(FreeExtent::Octant { level: cube.level }));
            } else if cube.level == 0 {
                buffer.cells.push(cube.free_cell(FreeExtent::Block));
            } else {
                self.push_children(&cube, &Classes::default(), |child| stack.push(child));
            }
        }
    }

    /// Queues a mixed block for refinement, unless its voxels are smaller than the spacing of the rays.
    fn queue_block(&self, block: Cube, scratch: &mut DescentScratch, buffer: &mut ThreadBuffer) {
        let (centre, half) = self.centre_and_half(&block);
        let range = self.classifier.range(centre);
        let finest = self.finest_free_scale(range);
        let rays = half / (self.classifier.spacing() * range);
        if finest > 2 || 2.0 * rays < f32::from(block.min_width) {
            if block.crossed {
                buffer.cells.push(block.free_block());
            }
            return;
        }
        scratch.partial.push(PartialBlock { block, mask: [0; 8], finest, rays });
    }

    /// Finds the free voxels of the queued blocks: three scales down, or to the spacing of the rays.
    ///
    /// A small cube that is not refined is free if a ray with a return beyond it passed through its centre, whatever the rays without return may have hit.
    fn refine_blocks(&self, scratch: &mut DescentScratch, buffer: &mut ThreadBuffer) {
        let DescentScratch { classify, centres, smaller_centres, classes, partial, parts, smaller, .. } = scratch;
        let half = 0.5 * BLOCK_EDGE as f32 * self.settings.voxel_size;
        parts.clear();
        centres.clear();
        for (i, partial) in partial.iter().enumerate() {
            parts.push(BlockPart { block: i as u32, index: 0 });
            centres.push(self.centre_and_half(&partial.block).0);
        }
        for depth in 0..3usize {
            let half = half / (1 << depth) as f32;
            self.classifier.classify(centres, half, classify, classes);
            buffer.visited += 8 * parts.len();
            smaller.clear();
            smaller_centres.clear();
            for ((part, classes), &centre) in parts.iter().zip(classes.iter()).zip(centres.iter()) {
                let PartialBlock { mask, finest, rays, .. } = &mut partial[part.block as usize];
                let refined = if *finest + depth < 2 { children_to_refine(classes, *rays / (1 << depth) as f32) } else { 0 };
                let free = classes.free | classes.crossed & !refined;
                for i in bits(free) {
                    set_cube(mask, 8 * part.index + i, depth);
                }
                for i in bits(refined) {
                    smaller.push(BlockPart { block: part.block, index: 8 * part.index + i });
                    smaller_centres.push(child_centre(centre, half, i));
                }
            }
            std::mem::swap(parts, smaller);
            std::mem::swap(centres, smaller_centres);
        }
        for PartialBlock { block, mask, .. } in partial.iter() {
            if *mask == [u64::MAX; 8] {
                buffer.cells.push(block.free_block());
            } else if *mask != [0; 8] {
                buffer.cells.push(block.free_cell(FreeExtent::Voxels { mask: buffer.masks.len() as u32, scale: coarsest_scale(mask) }));
                buffer.masks.push(*mask);
            }
        }
    }

    /// The finest scale at which free space is distinguished at `range` metres: its voxels are no smaller than the spacing of the rays, so that a ray passes
    /// through each.
    #[inline(always)]
    fn finest_free_scale(&self, range: f32) -> usize {
        let voxels = range * self.classifier.spacing() / self.settings.voxel_size;
        usize::from(voxels > 1.0) + usize::from(voxels > 2.0) + usize::from(voxels > 4.0)
    }
}

/// Locks; a panic of another thread is reported elsewhere.
fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Centre of the i-th of the eight cubes that make up the cube of edge `2 * half` around `centre`.
#[inline(always)]
fn child_centre(centre: [f32; 3], half: f32, i: usize) -> [f32; 3] {
    let step = |k: usize| centre[k] + if i >> k & 1 == 1 { 0.5 * half } else { -0.5 * half };
    [step(0), step(1), step(2)]
}
