//! Map-to-sensor descent (paper Sec. III-A): from the root down, which octants lie wholly in free space?
//!
//! The descent only reads the map, so it runs in parallel over subtrees; what it finds is a list of [`Found`] in Morton
//! order. It stops at octants that are free, that no beam reached, that are saturated free already (surfaces come from
//! beam walks, so another look could teach nothing there), or that are no larger than the beams' spacing.

use super::model::{OccupancySettings, Steps, free_margin};
use super::visibility::Visibility;
use crate::field::occupancy::{OccupancyField, Summary};
use crate::geometry::Rigid;
use crate::octree::{BLOCK_EDGE, NONE, block_coords};
use crate::sensor::atan2;
use rayon::prelude::*;

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
    /// Octants held against the pyramid, voxels of blocks included.
    pub visited: usize,
}

/// What the scan says about a cube.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Class {
    /// No beam passed: outside the field of view, or behind what was seen.
    Blind,
    /// Every beam through it went on.
    Free,
    /// Neither, or too near to tell.
    Mixed,
}

/// A cube that the descent looks into: an octant, or a virtual one below a uniform octant.
#[derive(Clone, Copy, Debug)]
struct Cube {
    key: u64,
    level: u32,
    link: u32,
    summary: Summary,
}

/// Everything that a descent reads.
pub(super) struct Descent<'a> {
    pub field: &'a OccupancyField,
    pub visibility: &'a Visibility,
    pub settings: &'a OccupancySettings,
    pub steps: Steps,
    pub t_submap_lidar: Rigid,
}

impl Descent<'_> {
    /// Finds the free octants of the field, which covers everything within the scan's reach.
    pub fn run(&self) -> Finds {
        /// Level of the subtrees that are descended in parallel: 64 blocks along an edge or less.
        const SPLIT: u32 = 5;
        let root = self.field.tree.root();
        let root = Cube { key: self.field.tree.root_key(), level: self.field.tree.root_level(), link: root.link, summary: root.payload };
        let mut top = Finds::default();
        let mut subtrees = vec![root];
        while let Some(level) = subtrees.iter().map(|c| c.level).max().filter(|&l| l > SPLIT) {
            subtrees = subtrees.iter().flat_map(|cube| if cube.level == level { self.open(cube) } else { vec![*cube] }).collect();
        }
        let parts: Vec<Finds> = subtrees
            .par_iter()
            .map(|cube| {
                let mut finds = Finds::default();
                self.descend(cube, &mut finds);
                finds
            })
            .collect();
        for part in parts {
            let first = top.masks.len() as u32;
            top.found.extend(part.found.iter().map(|f| match *f {
                Found::Voxels { key, mask, scale } => Found::Voxels { key, mask: mask + first, scale },
                other => other,
            }));
            top.masks.extend_from_slice(&part.masks);
            top.visited += part.visited;
        }
        top
    }

    /// The children of a large cube that are worth a descent.
    fn open(&self, cube: &Cube) -> Vec<Cube> {
        let classes = self.classify(cube);
        (0..8).filter(|&i| classes[i] != Class::Blind).map(|i| self.child(cube, i)).filter(|c| !self.is_known(c)).collect()
    }

    #[inline(always)]
    fn child(&self, cube: &Cube, i: usize) -> Cube {
        let level = cube.level - 1;
        let key = cube.key | (i as u64) << (3 * level);
        if cube.link == NONE {
            Cube { key, level, link: NONE, summary: cube.summary }
        } else {
            let octant = self.field.tree.siblings(cube.link)[i];
            Cube { key, level, link: octant.link, summary: octant.payload }
        }
    }

    #[inline(always)]
    fn is_known(&self, cube: &Cube) -> bool {
        cube.summary.is_saturated_free(self.steps.min)
    }

    fn descend(&self, cube: &Cube, finds: &mut Finds) {
        let classes = self.classify(cube);
        finds.visited += 8;
        for (i, class) in classes.into_iter().enumerate() {
            if class == Class::Blind {
                continue;
            }
            let child = self.child(cube, i);
            if self.is_known(&child) {
                continue;
            }
            match class {
                Class::Free => self.take(&child, finds),
                _ if child.level == 0 => self.look_into_block(&child, finds),
                _ => self.descend(&child, finds),
            }
        }
    }

    /// Everything below a free cube is free, whatever it is made of.
    fn take(&self, cube: &Cube, finds: &mut Finds) {
        if cube.link == NONE {
            finds.found.push(Found::Octant { key: cube.key, level: cube.level });
        } else if cube.level == 0 {
            finds.found.push(Found::Block { key: cube.key });
        } else {
            for i in 0..8 {
                let child = self.child(cube, i);
                if !self.is_known(&child) {
                    self.take(&child, finds);
                }
            }
        }
    }

    /// The eight children of a cube at or above block level.
    #[inline(always)]
    fn classify(&self, cube: &Cube) -> [Class; 8] {
        let blocks = (1u32 << cube.level) as f32;
        let corner = block_coords(cube.key);
        let edge = BLOCK_EDGE as f32 * self.settings.voxel;
        self.classify_children(std::array::from_fn(|k| (corner[k] as f32 + 0.5 * blocks) * edge), 0.5 * blocks * edge)
    }

    /// Looks for free voxels in a block that is neither free nor blind as a whole.
    fn look_into_block(&self, block: &Cube, finds: &mut Finds) {
        let half = 0.5 * BLOCK_EDGE as f32 * self.settings.voxel;
        let corner = block_coords(block.key);
        let centre: [f32; 3] = std::array::from_fn(|k| (corner[k] as f32 * 2.0 + 1.0) * half);
        let range = (0..3).map(|k| (centre[k] - self.t_submap_lidar.translation[k]).powi(2)).sum::<f32>().sqrt();
        let finest = self.finest_free_scale(range);
        if finest >= 3 {
            return;
        }
        let mut look = Look { finest, mask: [0; 8], visited: 0 };
        self.look(&mut look, centre, half, 2, 0);
        finds.visited += look.visited;
        let mask = look.mask;
        let scale = coarsest_scale(&mask);
        if mask == [u64::MAX; 8] {
            finds.found.push(if block.link == NONE { Found::Octant { key: block.key, level: 0 } } else { Found::Block { key: block.key } });
        } else if mask != [0; 8] {
            finds.found.push(Found::Voxels { key: block.key, mask: finds.masks.len() as u32, scale });
            finds.masks.push(mask);
        }
    }

    /// Classifies the eight voxels of `scale` in the cube of edge `2 * half` around `centre`, looks into the mixed ones, and
    /// notes what is free; the cube's first finest voxel in Morton order is `first`.
    fn look(&self, look: &mut Look, centre: [f32; 3], half: f32, scale: usize, first: usize) {
        let voxels = 1usize << (3 * scale);
        look.visited += 8;
        for (i, class) in self.classify_children(centre, half).into_iter().enumerate() {
            let at = first + i * voxels;
            match class {
                Class::Free => look.mask[at >> 6] |= (u64::MAX >> (64 - voxels)) << (at & 63),
                Class::Mixed if scale > look.finest => {
                    let child = std::array::from_fn(|k| centre[k] + if i >> k & 1 == 1 { 0.5 } else { -0.5 } * half);
                    self.look(look, child, 0.5 * half, scale - 1, at);
                }
                _ => {}
            }
        }
    }

    /// The finest scale at which free space is told apart at `range` metres: no finer than the beams are spaced there.
    #[inline(always)]
    fn finest_free_scale(&self, range: f32) -> usize {
        let spacing = range / self.visibility.rows().per_radian.min(self.visibility.columns_per_radian());
        let voxels = spacing / self.settings.voxel;
        usize::from(voxels >= 2.0) + usize::from(voxels >= 4.0) + usize::from(voxels >= 8.0)
    }

    /// Holds the eight cubes of edge `half` around `centre` (submap frame, metres) against the pyramid.
    #[inline(always)]
    fn classify_children(&self, centre: [f32; 3], half: f32) -> [Class; 8] {
        /// Beyond this ratio of radius to distance the sine is no longer the angle, and the cube fills the view anyway.
        const WIDE: f32 = 0.5;
        /// A sine this small underrates its angle by at most this factor.
        const ARC: f32 = 1.05;
        /// Inaccuracy of rows, columns and the sphere's silhouette, in pixels.
        const SLACK: f32 = 0.05;
        let t = &self.t_submap_lidar;
        let offset: [f32; 3] = std::array::from_fn(|k| centre[k] - t.translation[k]);
        // Columns of the rotation are the lidar's axes in the submap: project onto them.
        let at: [f32; 3] = std::array::from_fn(|j| (0..3).map(|i| t.rotation[i][j] * offset[i]).sum());
        let radius = 0.5 * half * 3f32.sqrt();
        let mut lanes = Lanes::default();
        for lane in 0..8 {
            let sign: [f32; 3] = std::array::from_fn(|k| if lane >> k & 1 == 1 { 0.5 * half } else { -0.5 * half });
            let p: [f32; 3] = std::array::from_fn(|j| at[j] + (0..3).map(|i| t.rotation[i][j] * sign[i]).sum::<f32>());
            let flat = p[0] * p[0] + p[1] * p[1];
            lanes.range[lane] = (flat + p[2] * p[2]).sqrt();
            lanes.flat[lane] = flat.sqrt();
            lanes.sine[lane] = p[2] / lanes.range[lane].max(1e-6);
            lanes.azimuth[lane] = atan2(p[1], p[0]);
        }
        let rows = self.visibility.rows();
        std::array::from_fn(|lane| {
            let (range, flat) = (lanes.range[lane], lanes.flat[lane]);
            if radius > WIDE * range {
                return Class::Mixed;
            }
            // The sine of the elevation changes by no more than the angle does.
            let angle = ARC * radius / range;
            if lanes.sine[lane] - angle > rows.highest || lanes.sine[lane] + angle < rows.lowest {
                return Class::Blind;
            }
            if radius > WIDE * flat {
                return Class::Mixed;
            }
            let row_radius = angle * rows.per_radian + SLACK;
            let column_radius = ARC * radius / flat * self.visibility.columns_per_radian() + SLACK;
            let Some(texel) =
                self.visibility.texel(rows.row(lanes.sine[lane]), self.visibility.column(lanes.azimuth[lane]), row_radius, column_radius)
            else {
                return Class::Mixed;
            };
            if range + radius + free_margin(self.settings, range) < texel.near {
                Class::Free
            } else if range - radius > texel.far {
                Class::Blind
            } else {
                Class::Mixed
            }
        })
    }
}

/// What was found so far within one block.
struct Look {
    /// Finest scale to tell apart.
    finest: usize,
    mask: Mask,
    visited: usize,
}

/// Eight cubes at once, one array per quantity, so that the arithmetic becomes SIMD.
#[derive(Default)]
struct Lanes {
    range: [f32; 8],
    flat: [f32; 8],
    sine: [f32; 8],
    azimuth: [f32; 8],
}

/// The coarsest scale at which every voxel of a mask is wholly set or wholly clear.
fn coarsest_scale(mask: &Mask) -> u8 {
    let whole_words = mask.iter().all(|w| *w == 0 || *w == u64::MAX);
    let whole_bytes = mask.iter().all(|w| w.to_le_bytes().iter().all(|b| *b == 0 || *b == u8::MAX));
    if whole_words { 2 } else { u8::from(whole_bytes) }
}
