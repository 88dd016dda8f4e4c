//! Map-to-sensor descent (paper Sec. III-A): from the root down, which octants lie wholly in free space?
//!
//! The descent only reads the map, so it runs in parallel over subtrees; what it finds is a list of [`Found`] in Morton
//! order. It stops at octants that are free, that hold nothing free, that are saturated free already (surfaces come from
//! beam walks, so another look could teach nothing there), or that are no larger than the beams' spacing.

use super::model::{OccupancySettings, Steps};
use super::sight::{Classes, Sight, bits};
use crate::dispatch::{Kernel, dispatch};
use crate::field::occupancy::{OccupancyField, Summary};
use crate::octree::{BLOCK_EDGE, NONE, block_coords};
use rayon::prelude::*;

// Where nothing was seen nearby there is no surface to be told apart from, so free space may end roughly there.
/// Cubes of blocks at the rim of the field of view are refined while they are wider than this many beams ...
const RIM_BEAMS: f32 = 3.0;
/// ... and cubes beside beams without return while they are wider than this many.
const HOLE_BEAMS: f32 = 2.0;

/// How many beams a mixed cube must be wide to be refined.
#[inline(always)]
fn coarse(classes: &Classes, i: usize) -> f32 {
    if classes.rim >> i & 1 == 1 {
        RIM_BEAMS
    } else if classes.holed >> i & 1 == 1 {
        HOLE_BEAMS
    } else {
        0.0
    }
}

/// The mixed cubes that are to be refined when each is `beams` wide.
#[inline(always)]
fn worth_a_look(classes: &Classes, beams: f32) -> u8 {
    let mut mixed = classes.mixed;
    if beams < RIM_BEAMS {
        mixed &= !classes.rim;
    }
    if beams < HOLE_BEAMS {
        mixed &= !classes.holed;
    }
    mixed
}

/// Free voxels of a block, a bit each in Morton order: word i is the i-th octant of the block.
pub(super) type Mask = [u64; 8];

/// Something free.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Found {
    /// A whole uniform octant: its smallest block's key and its level.
    Octant { key: u64, level: u32 },
    /// A whole block that holds voxels.
    Block { key: u64 },
    /// Some voxels of a block: which, and the coarsest scale that can tell them apart.
    Voxels { key: u64, mask: u32, scale: u8 },
}

/// What a descent found.
#[derive(Clone, Debug, Default)]
pub(super) struct Finds {
    pub found: Vec<Found>,
    pub masks: Vec<Mask>,
    /// Cubes held against the pyramid, voxels of blocks included.
    pub visited: usize,
}

/// A cube that the descent looks into: an octant, or a virtual one below a uniform octant.
#[derive(Clone, Copy, Debug)]
struct Cube {
    key: u64,
    level: u32,
    link: u32,
    summary: Summary,
    /// A larger cube around it was found free.
    free: bool,
    /// A beam went through its middle, and it is free as far as beams came back.
    crossed: bool,
    /// How small it may be left alone, in beams across: more than 0 at the rim of what was seen.
    coarse: f32,
}

/// Everything that a descent reads.
pub(super) struct Descent<'a> {
    pub field: &'a OccupancyField,
    pub sight: Sight<'a>,
    pub settings: &'a OccupancySettings,
    pub steps: Steps,
}

/// A subtree to descend and where to note what is found.
struct Subtree<'a> {
    descent: &'a Descent<'a>,
    root: Cube,
    finds: &'a mut Finds,
}

impl Kernel for Subtree<'_> {
    #[inline(always)]
    fn run(self) {
        self.descent.descend(self.root, self.finds);
    }
}

impl Descent<'_> {
    /// Finds the free octants of the field, which covers everything within the scan's reach.
    pub fn run(&self) -> Finds {
        let tree = &self.field.tree;
        let root = Cube {
            key: tree.root_key(),
            level: tree.root_level(),
            link: tree.root().link,
            summary: tree.root().payload,
            free: false,
            crossed: false,
            coarse: 0.0,
        };
        let mut subtrees = vec![root];
        while subtrees.iter().any(|cube| self.is_too_much_work(cube)) {
            subtrees = subtrees.iter().flat_map(|cube| if self.is_too_much_work(cube) { self.children(cube).1 } else { vec![*cube] }).collect();
        }
        let parts: Vec<Finds> = subtrees
            .par_iter()
            .map(|&root| {
                let mut finds = Finds::default();
                dispatch(Subtree { descent: self, root, finds: &mut finds });
                finds
            })
            .collect();
        let mut all = Finds::default();
        for part in parts {
            let first = all.masks.len() as u32;
            all.found.extend(part.found.iter().map(|f| match *f {
                Found::Voxels { key, mask, scale } => Found::Voxels { key, mask: mask + first, scale },
                other => other,
            }));
            all.masks.extend_from_slice(&part.masks);
            all.visited += part.visited;
        }
        all
    }

    /// Whether a cube is cut further before threads share the work. Cubes are refined to the beams' spacing, which grows with the range, so
    /// those that look equally large from the sensor are about equal work.
    fn is_too_much_work(&self, cube: &Cube) -> bool {
        const LARGEST: u32 = 5;
        let (centre, half) = self.place(cube);
        cube.level > LARGEST || (cube.level > 1 && 2.0 * half > self.sight.range(centre))
    }

    /// How many children of a cube were looked at, and those that may hold something free, in Morton order.
    fn children(&self, cube: &Cube) -> (usize, Vec<Cube>) {
        let mut children = Vec::new();
        let visited = self.open(cube, |child| children.push(child));
        children.reverse();
        (visited, children)
    }

    /// Hands over the children that may hold something free, last in Morton order first; returns how many were looked at.
    #[inline(always)]
    fn open(&self, cube: &Cube, mut push: impl FnMut(Cube)) -> usize {
        let classes = if cube.free {
            Classes { free: u8::MAX, ..Classes::default() }
        } else {
            let (centre, half) = self.place(cube);
            self.sight.classify(centre, half)
        };
        let (free, mixed) = (classes.free, classes.mixed);
        let level = cube.level - 1;
        for i in (0..8usize).rev().filter(|i| (free | mixed) >> i & 1 == 1) {
            let (link, summary) = if cube.link == NONE {
                (NONE, cube.summary)
            } else {
                let octant = self.field.tree.siblings(cube.link)[i];
                (octant.link, octant.payload)
            };
            if !summary.is_saturated_free(self.steps.min) {
                push(Cube {
                    key: cube.key | (i as u64) << (3 * level),
                    level,
                    link,
                    summary,
                    free: free >> i & 1 == 1,
                    crossed: classes.crossed >> i & 1 == 1,
                    coarse: coarse(&classes, i),
                });
            }
        }
        if cube.free { 0 } else { 8 }
    }

    /// Centre and half the edge of a cube, metres, submap frame.
    #[inline(always)]
    fn place(&self, cube: &Cube) -> ([f32; 3], f32) {
        let edge = BLOCK_EDGE as f32 * self.settings.voxel;
        let half = 0.5 * (1u32 << cube.level) as f32;
        let corner = block_coords(cube.key);
        let middle = |k: usize| (corner[k] as f32 + half) * edge;
        ([middle(0), middle(1), middle(2)], half * edge)
    }

    #[inline(always)]
    fn descend(&self, root: Cube, finds: &mut Finds) {
        let mut stack = vec![root];
        while let Some(cube) = stack.pop() {
            if cube.free && cube.link == NONE {
                finds.found.push(Found::Octant { key: cube.key, level: cube.level });
            } else if cube.level > 0 {
                finds.visited += self.open(&cube, |child| stack.push(child));
            } else if cube.free {
                finds.found.push(Found::Block { key: cube.key });
            } else {
                self.look_into_block(&cube, finds);
            }
        }
    }

    /// Looks for free voxels in a block of which only a part may be free: three scales down, or as far as beams tell apart.
    #[inline(always)]
    fn look_into_block(&self, block: &Cube, finds: &mut Finds) {
        let (centre, half) = self.place(block);
        let range = self.sight.range(centre);
        let finest = self.finest_free_scale(range);
        // Beams across a cube of half the block's edge, of a quarter, of an eighth.
        let beams = half / (self.sight.spacing() * range);
        if finest > 2 || 2.0 * beams < block.coarse {
            if block.crossed {
                finds.found.push(whole(block));
            }
            return;
        }
        // A small cube that is not looked into is free if a beam crossed it, whatever the beams without return might have met.
        let mut mask: Mask = [0; 8];
        let quarters = self.sight.classify(centre, half);
        let look = if finest < 2 { worth_a_look(&quarters, beams) } else { 0 };
        bits(quarters.free | quarters.crossed & !look).for_each(|i| mask[i] = u64::MAX);
        finds.visited += 8;
        for i in bits(look) {
            let (centre, half) = (child_centre(centre, half, i), 0.5 * half);
            let pairs = self.sight.classify(centre, half);
            let look = if finest < 1 { worth_a_look(&pairs, 0.5 * beams) } else { 0 };
            bits(pairs.free | pairs.crossed & !look).for_each(|j| mask[i] |= 0xff << (8 * j));
            finds.visited += 8;
            for j in bits(look) {
                let voxels = self.sight.classify(child_centre(centre, half, j), 0.5 * half);
                mask[i] |= u64::from(voxels.free | voxels.crossed) << (8 * j);
                finds.visited += 8;
            }
        }
        if mask == [u64::MAX; 8] {
            finds.found.push(whole(block));
        } else if mask != [0; 8] {
            finds.found.push(Found::Voxels { key: block.key, mask: finds.masks.len() as u32, scale: coarsest_scale(&mask) });
            finds.masks.push(mask);
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

/// All of a block is free.
fn whole(block: &Cube) -> Found {
    if block.link == NONE { Found::Octant { key: block.key, level: 0 } } else { Found::Block { key: block.key } }
}

/// Centre of the i-th of the eight cubes that make up the cube of edge `2 * half` around `centre`.
#[inline(always)]
fn child_centre(centre: [f32; 3], half: f32, i: usize) -> [f32; 3] {
    let step = |k: usize| centre[k] + if i >> k & 1 == 1 { 0.5 * half } else { -0.5 * half };
    [step(0), step(1), step(2)]
}

/// The coarsest scale at which every voxel of a mask is wholly set or wholly clear.
fn coarsest_scale(mask: &Mask) -> u8 {
    let whole_words = mask.iter().all(|w| *w == 0 || *w == u64::MAX);
    let whole_bytes = mask.iter().all(|w| w.to_le_bytes().iter().all(|b| *b == 0 || *b == u8::MAX));
    if whole_words { 2 } else { u8::from(whole_bytes) }
}
