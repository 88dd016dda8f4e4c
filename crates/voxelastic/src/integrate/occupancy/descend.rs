//! Map-to-sensor descent (paper Sec. III-A): from the root down, which octants lie wholly in free space?
//!
//! The descent only reads the map, so it runs in parallel over subtrees, in each of them through all cubes of one size before the
//! next smaller ones, so that many are looked at together; what it finds is a list of [`Found`] in Morton order. It stops at octants that are free, that hold nothing free, that are saturated free already (surfaces come from
//! beam walks, so another look could teach nothing there), or that are no larger than the beams' spacing.

use super::found::{Finds, Found, Heap, Mask, Spot, Stretch, What, coarsest_scale, note};
use super::model::{OccupancySettings, Steps};
use super::sight::{Classes, Scratch, Sight, bits};
use crate::field::occupancy::{OccupancyField, Summary};
use crate::octree::{BLOCK_EDGE, NONE, ask_for_all, block_coords};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

// Where nothing was seen nearby there is no surface to be told apart from, so free space may end roughly there.
/// Cubes of blocks at the rim of the field of view are refined while they are wider than this many beams ...
const RIM_BEAMS: u8 = 3;
/// ... and cubes beside beams without return while they are wider than this many.
const HOLE_BEAMS: u8 = 2;

/// How many beams a mixed cube must be wide to be refined.
#[inline(always)]
fn coarse(classes: &Classes, i: usize) -> u8 {
    if classes.rim >> i & 1 == 1 {
        RIM_BEAMS
    } else if classes.holed >> i & 1 == 1 {
        HOLE_BEAMS
    } else {
        0
    }
}

/// The mixed cubes that are to be refined when each is `beams` wide.
#[inline(always)]
fn worth_a_look(classes: &Classes, beams: f32) -> u8 {
    let mut mixed = classes.mixed;
    if beams < f32::from(RIM_BEAMS) {
        mixed &= !classes.rim;
    }
    if beams < f32::from(HOLE_BEAMS) {
        mixed &= !classes.holed;
    }
    mixed
}

/// How many cubes ahead the octants below one are asked for.
const AHEAD: usize = 4;

/// A cube that the descent looks into: an octant, or a virtual one below a uniform octant.
#[derive(Clone, Copy, Debug)]
struct Cube {
    key: u64,
    /// The block coordinates of `key`, which are much looked at and slow to get from it.
    corner: [i32; 3],
    at: Spot,
    link: u32,
    level: u8,
    summary: Summary,
    /// A larger cube around it was found free.
    free: bool,
    /// A beam went through its middle, and it is free as far as beams came back.
    crossed: bool,
    /// How small it may be left alone, in beams across: more than 0 at the rim of what was seen.
    coarse: u8,
}

impl Cube {
    #[inline(always)]
    fn level(&self) -> u32 {
        u32::from(self.level)
    }

    /// Something of it is free.
    #[inline(always)]
    fn found(&self, what: What) -> Found {
        let block = if self.level == 0 { self.link } else { NONE };
        Found { key: self.key, at: self.at, block, what }
    }

    /// All of a block is free.
    fn whole(&self) -> Found {
        self.found(if self.link == NONE { What::Octant { level: 0 } } else { What::Block })
    }

    /// The `i`-th of its eight children, as far as its own place says.
    #[inline(always)]
    fn child(&self, i: usize) -> (u64, [i32; 3]) {
        let level = self.level() - 1;
        let step = |k: usize| self.corner[k] + ((i as i32 >> k & 1) << level);
        (self.key | (i as u64) << (3 * level), [step(0), step(1), step(2)])
    }
}

/// Everything that a descent reads.
pub(super) struct Descent<'a> {
    pub field: &'a OccupancyField,
    pub sight: Sight<'a>,
    pub settings: &'a OccupancySettings,
    pub steps: Steps,
}

/// A cube of a block whose children are looked at: the block itself, half its edge or a quarter.
#[derive(Clone, Copy, Debug)]
struct Part {
    /// Place in the list of blocks.
    block: u32,
    /// Which of the block's cubes of this size, in Morton order.
    place: usize,
}

/// A block that is looked into.
#[derive(Clone, Copy, Debug)]
struct Inner {
    block: Cube,
    mask: Mask,
    finest: usize,
    /// Beams across a cube of half the block's edge.
    beams: f32,
}

/// Memory of a thread that descends, kept from scan to scan: cubes of one size and what is seen of their children.
#[derive(Clone, Debug)]
pub(super) struct Memory {
    scratch: Scratch,
    centres: Vec<[f32; 3]>,
    classes: Vec<Classes>,
    cubes: Vec<Cube>,
    children: Vec<Cube>,
    stack: Vec<Cube>,
    inner: Vec<Inner>,
    parts: Vec<Part>,
    smaller: Vec<Part>,
    smaller_centres: Vec<[f32; 3]>,
}

impl Memory {
    fn new() -> Self {
        Self {
            scratch: Scratch::new(),
            centres: Vec::new(),
            classes: Vec::new(),
            cubes: Vec::new(),
            children: Vec::new(),
            stack: Vec::new(),
            inner: Vec::new(),
            parts: Vec::new(),
            smaller: Vec::new(),
            smaller_centres: Vec::new(),
        }
    }
}

impl Descent<'_> {
    /// Finds the free octants of the field, which covers everything within the scan's reach.
    pub fn run(&self, memories: &mut Vec<Box<Memory>>, finds: &mut Finds) {
        let tree = &self.field.tree;
        let root = Cube {
            key: tree.root_key(),
            corner: block_coords(tree.root_key()),
            level: tree.root_level() as u8,
            at: Spot::NOWHERE,
            link: tree.root().link,
            summary: tree.root().payload,
            free: false,
            crossed: false,
            coarse: 0,
        };
        let subtrees = self.subtrees(root, memories);
        finds.heaps.resize_with(memories.len(), Heap::default);
        finds.heaps.iter_mut().for_each(Heap::clear);
        // Handed on from subtree to subtree: each may be taken by another thread, because they are not equal work.
        let made = AtomicU32::new(memories.len() as u32);
        let spare = Mutex::new((0..).zip(memories.drain(..).zip(finds.heaps.drain(..))).collect::<Vec<_>>());
        let descend = |&root: &Cube| {
            let known = open(&spare).pop();
            let make = || (made.fetch_add(1, Ordering::Relaxed), (Box::new(Memory::new()), Heap::default()));
            let (number, (mut memory, mut heap)) = known.unwrap_or_else(make);
            let start = heap.found.len() as u32;
            self.descend(root, &mut memory, &mut heap);
            let end = heap.found.len() as u32;
            open(&spare).push((number, (memory, heap)));
            Stretch { heap: number, start, end }
        };
        subtrees.par_iter().with_max_len(1).map(descend).collect_into_vec(&mut finds.stretches);
        let mut all = std::mem::take(&mut *open(&spare));
        all.sort_unstable_by_key(|(number, _)| *number);
        (*memories, finds.heaps) = all.into_iter().map(|(_, both)| both).unzip();
    }

    /// The tree cut into shares for threads.
    fn subtrees(&self, root: Cube, memories: &mut Vec<Box<Memory>>) -> Vec<Cube> {
        let mut memory = memories.pop().unwrap_or_else(|| Box::new(Memory::new()));
        let mut subtrees = vec![root];
        loop {
            // All of them are equally large: the smaller ones of earlier rounds are little enough work.
            let large: Vec<Cube> = subtrees.iter().copied().filter(|cube| self.is_too_much_work(cube)).collect();
            if large.is_empty() {
                memories.push(memory);
                return subtrees;
            }
            self.look(&large, &mut memory);
            let mut classes = memory.classes.iter();
            let mut smaller = Vec::new();
            for cube in &subtrees {
                match classes.as_slice().first() {
                    Some(seen) if self.is_too_much_work(cube) => {
                        classes.next();
                        self.open(cube, seen, |child| smaller.push(child));
                    }
                    _ => smaller.push(*cube),
                }
            }
            subtrees = smaller;
        }
    }

    /// Whether a cube is cut further before threads share the work. Cubes are refined to the beams' spacing, which grows with the range, so
    /// those that look equally large from the sensor are about equal work.
    fn is_too_much_work(&self, cube: &Cube) -> bool {
        const LARGEST: u32 = 5;
        let (centre, half) = self.place(cube);
        cube.level() > LARGEST || (cube.level > 1 && 2.0 * half > self.sight.range(centre))
    }

    /// Looks at the children of `cubes`, which are equally large.
    fn look(&self, cubes: &[Cube], memory: &mut Memory) {
        memory.centres.clear();
        memory.centres.extend(cubes.iter().map(|cube| self.place(cube).0));
        let half = cubes.first().map_or(0.0, |cube| self.place(cube).1);
        self.sight.classify(&memory.centres, half, &mut memory.scratch, &mut memory.classes);
    }

    /// Hands over the children that may hold something free, in Morton order.
    fn open(&self, cube: &Cube, classes: &Classes, mut push: impl FnMut(Cube)) {
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
                    at: if cube.link == NONE { Spot::NOWHERE } else { Spot::new((cube.link, i)) },
                    link,
                    summary,
                    free: free >> i & 1 == 1,
                    crossed: classes.crossed >> i & 1 == 1,
                    coarse: coarse(classes, i),
                });
            }
        }
    }

    /// Asks for the octants below a cube, which are read soon.
    #[inline(always)]
    fn ask_for(&self, cube: Option<&Cube>) {
        if let Some(cube) = cube.filter(|cube| cube.link != NONE) {
            ask_for_all(&raw const *self.field.tree.siblings(cube.link));
        }
    }

    /// Centre and half the edge of a cube, metres, submap frame.
    #[inline(always)]
    fn place(&self, cube: &Cube) -> ([f32; 3], f32) {
        let edge = BLOCK_EDGE as f32 * self.settings.voxel;
        let half = 0.5 * (1u32 << cube.level) as f32;
        let middle = |k: usize| (cube.corner[k] as f32 + half) * edge;
        ([middle(0), middle(1), middle(2)], half * edge)
    }

    /// Finds what is free below `root`, all cubes of one size after the other.
    fn descend(&self, root: Cube, memory: &mut Memory, heap: &mut Heap) {
        let start = heap.found.len();
        memory.cubes.clear();
        memory.inner.clear();
        self.sort_out(root, memory, heap);
        std::mem::swap(&mut memory.cubes, &mut memory.children);
        while !memory.cubes.is_empty() {
            let cubes = std::mem::take(&mut memory.cubes);
            self.look(&cubes, memory);
            heap.visited += 8 * cubes.len();
            let classes = std::mem::take(&mut memory.classes);
            for (i, (cube, classes)) in cubes.iter().zip(&classes).enumerate() {
                self.ask_for(cubes.get(i + AHEAD));
                self.open(cube, classes, |child| self.sort_out(child, memory, heap));
            }
            (memory.cubes, memory.classes) = (cubes, classes);
            memory.cubes.clear();
            std::mem::swap(&mut memory.cubes, &mut memory.children);
        }
        self.look_into_blocks(memory, heap);
        // Lists by size become one in Morton order.
        let found = &mut heap.found[start..];
        found.sort_unstable_by_key(|found| found.key);
        heap.octants += found.iter().filter(|found| matches!(found.what, What::Octant { .. })).count();
    }

    /// Notes all that is free of a free cube, or where to look on.
    fn sort_out(&self, cube: Cube, memory: &mut Memory, heap: &mut Heap) {
        if !cube.free {
            if cube.level > 0 {
                memory.children.push(cube);
            } else {
                self.enter(cube, memory, heap);
            }
            return;
        }
        let stack = &mut memory.stack;
        stack.push(cube);
        while let Some(cube) = stack.pop() {
            if cube.link == NONE {
                heap.found.push(cube.found(What::Octant { level: cube.level }));
            } else if cube.level == 0 {
                heap.found.push(cube.found(What::Block));
            } else {
                self.open(&cube, &Classes::default(), |child| stack.push(child));
            }
        }
    }

    /// Whether to look for free voxels in a block of which only a part may be free.
    fn enter(&self, block: Cube, memory: &mut Memory, heap: &mut Heap) {
        let (centre, half) = self.place(&block);
        let range = self.sight.range(centre);
        let finest = self.finest_free_scale(range);
        let beams = half / (self.sight.spacing() * range);
        if finest > 2 || 2.0 * beams < f32::from(block.coarse) {
            if block.crossed {
                heap.found.push(block.whole());
            }
            return;
        }
        memory.inner.push(Inner { block, mask: [0; 8], finest, beams });
    }

    /// Looks for free voxels in blocks: three scales down, or as far as beams tell apart.
    ///
    /// A small cube that is not looked into is free if a beam crossed it, whatever the beams without return might have met.
    fn look_into_blocks(&self, memory: &mut Memory, heap: &mut Heap) {
        let Memory { scratch, centres, smaller_centres, classes, inner, parts, smaller, .. } = memory;
        let half = 0.5 * BLOCK_EDGE as f32 * self.settings.voxel;
        parts.clear();
        centres.clear();
        for (i, inner) in inner.iter().enumerate() {
            parts.push(Part { block: i as u32, place: 0 });
            centres.push(self.place(&inner.block).0);
        }
        for depth in 0..3usize {
            let half = half / (1 << depth) as f32;
            self.sight.classify(centres, half, scratch, classes);
            heap.visited += 8 * parts.len();
            smaller.clear();
            smaller_centres.clear();
            for ((part, classes), &centre) in parts.iter().zip(classes.iter()).zip(centres.iter()) {
                let Inner { mask, finest, beams, .. } = &mut inner[part.block as usize];
                let look = if *finest + depth < 2 { worth_a_look(classes, *beams / (1 << depth) as f32) } else { 0 };
                let free = classes.free | classes.crossed & !look;
                for i in bits(free) {
                    note(mask, 8 * part.place + i, depth);
                }
                for i in bits(look) {
                    smaller.push(Part { block: part.block, place: 8 * part.place + i });
                    smaller_centres.push(child_centre(centre, half, i));
                }
            }
            std::mem::swap(parts, smaller);
            std::mem::swap(centres, smaller_centres);
        }
        for Inner { block, mask, .. } in inner.iter() {
            if *mask == [u64::MAX; 8] {
                heap.found.push(block.whole());
            } else if *mask != [0; 8] {
                heap.found.push(block.found(What::Voxels { mask: heap.masks.len() as u32, scale: coarsest_scale(mask) }));
                heap.masks.push(*mask);
            }
        }
    }

    /// The finest scale at which free space is told apart at `range` metres: its voxels are no smaller than the beams are
    /// spaced there, so that a beam went through each.
    #[inline(always)]
    fn finest_free_scale(&self, range: f32) -> usize {
        let voxels = range * self.sight.spacing() / self.settings.voxel;
        usize::from(voxels > 1.0) + usize::from(voxels > 2.0) + usize::from(voxels > 4.0)
    }
}

/// What threads hand on to each other; should one of them panic, that is told elsewhere.
fn open<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Centre of the i-th of the eight cubes that make up the cube of edge `2 * half` around `centre`.
#[inline(always)]
fn child_centre(centre: [f32; 3], half: f32, i: usize) -> [f32; 3] {
    let step = |k: usize| centre[k] + if i >> k & 1 == 1 { 0.5 * half } else { -0.5 * half };
    [step(0), step(1), step(2)]
}
