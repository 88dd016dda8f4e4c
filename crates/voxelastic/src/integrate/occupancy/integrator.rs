//! The integrator: one scan into one occupancy field.
//!
//! *See*: build the pyramid. *Descend*: find free space. *Select*: which blocks the beams' hit bands touch. *Allocate*: make
//! and refine blocks. *Update*: each block on its own, in parallel. *Propagate*: maxima and "observed" up to the root, and
//! equal siblings merged into their parent.

use super::allocate::{Free, Touch, Touches};
use super::apply::{Formation, FreeVoxels, Outcome, Place, Updates};
use super::descend::{Descent, Memory};
use super::found::Finds;
use super::model::{Evidence, OccupancySettings, Steps};
use super::propagate::Touched;
use super::sight::Sight;
use super::visibility::Visibility;
use crate::dispatch::{Kernel, dispatch};
use crate::field::StoreCells;
use crate::field::occupancy::{OccupancyBlock, OccupancyField, Summary};
use crate::geometry::Rigid;
use crate::integrate::scale::ScaleRule;
use crate::integrate::select::{MAX_BEAMS, MAX_REACH, Selection, beam_of};
use crate::integrate::transform::{Beam, Returns, ToSubmap, to_submap};
use crate::octree::{BLOCK_EDGE, NONE, Octant, Pool, SCALES, block_coords, block_key, prefetch};
use crate::sensor::{BeamModel, RangeImage};
use rayon::prelude::*;
use std::time::{Duration, Instant};

/// Time spent in each phase of one integration.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OccupancyPhases {
    /// The pyramid, and beams into the submap frame.
    pub see: Duration,
    /// The descent for free space.
    pub descend: Duration,
    /// Blocks touched by beams, grouped.
    pub select: Duration,
    /// Octants and blocks made.
    pub allocate: Duration,
    /// Voxels updated.
    pub update: Duration,
    /// Summaries up to the root, pruning.
    pub propagate: Duration,
}

/// What one integration did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OccupancyStats {
    /// Beams walked.
    pub beams: usize,
    /// Cubes held against the pyramid.
    pub visited: usize,
    /// Uniform octants found free.
    pub free_octants: usize,
    /// Blocks updated.
    pub blocks: usize,
    /// Where the time went.
    pub phases: OccupancyPhases,
}

/// Integrates scans into [`OccupancyField`]s; holds the scratch memory, so keep one for all scans.
#[derive(Clone, Debug)]
pub struct OccupancyIntegrator {
    settings: OccupancySettings,
    visibility: Visibility,
    beams: Vec<Beam>,
    selection: Selection,
    touches: Touches,
    memories: Vec<Box<Memory>>,
    finds: Finds,
    outcomes: Vec<Outcome>,
}

/// Blocks finer than this are not coarsened again: detail once seen stays.
const KEEP_DETAIL: f32 = f32::INFINITY;

impl OccupancyIntegrator {
    /// An integrator for scans of `model`.
    pub fn new(settings: OccupancySettings, model: &BeamModel) -> Self {
        Self {
            settings,
            visibility: Visibility::new(model),
            beams: Vec::new(),
            selection: Selection::default(),
            touches: Touches::default(),
            memories: Vec::new(),
            finds: Finds::default(),
            outcomes: Vec::new(),
        }
    }

    /// Integrates one scan taken at `t_submap_lidar`: free space from its image, surfaces from its returns. `fill` says that
    /// the points were no grid, so that single empty pixels between returns are accidents.
    pub fn integrate(
        &mut self,
        field: &mut OccupancyField,
        t_submap_lidar: &Rigid,
        image: &RangeImage,
        returns: &Returns<'_>,
        fill: bool,
    ) -> OccupancyStats {
        let settings = self.settings.clone();
        let steps = Steps::new(&settings);
        let rule = ScaleRule::new(returns.smallest_angle, settings.voxel, SCALES - 1, KEEP_DETAIL);
        let count = returns.points.len().min(MAX_BEAMS);
        let returns = Returns { points: &returns.points[..count], normals: &[], ..*returns };

        let reach = self.cover(field, t_submap_lidar.translation);
        let sensor = t_submap_lidar.translation.map(|c| c / settings.voxel);
        let Self { visibility, selection, beams, touches, memories, finds, .. } = self;
        let descend = || {
            let ((), see) = timed(|| visibility.build(image, settings.max_range, settings.clear_no_return, fill));
            let sight = Sight::new(visibility, &settings, t_submap_lidar);
            let ((), descend) = timed(|| Descent { field, sight, settings: &settings, steps }.run(memories, finds));
            (see, descend)
        };
        let select = || {
            /// Fewer beams are not worth a second thread.
            const BEAMS_PER_TASK: usize = 4096;
            let OccupancySettings { voxel, max_range, .. } = settings;
            let single =
                ToSubmap { t_submap_lidar: *t_submap_lidar, voxel, max_range, rule, least_slope: 0.0, band: [0.0; 2], along: 0.0, bundle_width: 0.0 };
            let ((), see) = timed(|| {
                to_submap(&returns, &single, beams);
                beams.par_iter_mut().with_min_len(BEAMS_PER_TASK).for_each(|beam| {
                    let (before, behind) = Evidence::new(&settings, beam.range * voxel, beam.scale as usize).reach();
                    beam.reach = [-before, behind];
                });
            });
            let ((), select) = timed(|| {
                selection.select(beams, sensor, reach);
                touches.look_up(field, &selection.blocks, &rule, voxel, t_submap_lidar.translation);
            });
            (see, select)
        };
        // Neither needs the other, and both have parts that leave threads idle.
        let ((see, descend), (transform, select)) = rayon::join(descend, select);

        let selected = Instant::now();
        let mut touched = self.touches.allocate(field, &self.finds, &self.selection.blocks, &steps);
        let allocated = Instant::now();

        self.update(field, &steps);
        let updated = Instant::now();

        self.settle(field, &mut touched);
        touched.propagate(field);
        let done = Instant::now();

        OccupancyStats {
            beams: self.beams.len(),
            visited: self.finds.heaps.iter().map(|heap| heap.visited).sum(),
            free_octants: self.finds.heaps.iter().map(|heap| heap.octants).sum(),
            blocks: self.touches.list.len(),
            phases: OccupancyPhases {
                see: see + transform,
                descend,
                select,
                allocate: allocated - selected,
                update: updated - allocated,
                propagate: done - updated,
            },
        }
    }

    /// Grows the root over everything within reach of the sensor; returns the reach in blocks.
    fn cover(&self, field: &mut OccupancyField, sensor: [f32; 3]) -> u32 {
        let edge = BLOCK_EDGE as f32 * self.settings.voxel;
        // A hit's band at the coarsest scale reaches this many finest voxels beyond its point.
        let band = self.settings.thickness_voxels.max(3.0) * (1 << (SCALES - 1)) as f32 * self.settings.voxel;
        let reach = (((self.settings.max_range + band) / edge).ceil() as u32 + 2).min(MAX_REACH);
        let home = sensor.map(|c| (c / edge).floor() as i32);
        field.tree.grow_to(block_key(home.map(|c| c - reach as i32)));
        field.tree.grow_to(block_key(home.map(|c| c + reach as i32)));
        reach
    }

    fn update(&mut self, field: &mut OccupancyField, steps: &Steps) {
        const TOUCHES_PER_TASK: usize = 64;
        let task = BlockUpdate {
            blocks: &field.blocks,
            voxels: field.voxels.cells(),
            beams: &self.beams,
            records: &self.selection.records,
            finds: &self.finds,
            settings: &self.settings,
            steps,
        };
        self.outcomes.clear();
        self.outcomes.resize(self.touches.list.len(), Outcome::default());
        let shares = self.touches.list.par_chunks(TOUCHES_PER_TASK).zip(self.outcomes.par_chunks_mut(TOUCHES_PER_TASK));
        shares.with_max_len(1).for_each(|(touches, outcomes)| dispatch(Share { touches, outcomes, task: &task }));
    }

    /// Writes each block's outcome to its octant; a block that became uniform gives its voxels back.
    #[allow(unsafe_code)]
    fn settle(&self, field: &mut OccupancyField, touched: &mut Touched) {
        /// Few enough that threads share evenly, many enough that what they note is quickly joined.
        const PER_TASK: usize = 4096;
        /// How many blocks ahead a head and an octant are asked for.
        const AHEAD: usize = 8;
        let (octants, blocks) = (field.tree.cells(), &field.blocks);
        let settle = |(touches, outcomes): (&[Touch], &[Outcome])| {
            let (mut touched, mut uniform) = (Touched::default(), Vec::new());
            for (i, (touch, outcome)) in touches.iter().zip(outcomes).enumerate() {
                if let Some(next) = touches.get(i + AHEAD) {
                    prefetch(&raw const blocks[next.block]);
                    prefetch(next.at.within(&octants).address());
                }
                touched.add(blocks[touch.block].key, 0);
                // SAFETY: a block is touched once, and of a group only that block's octant is referred to.
                let octant = unsafe { touch.at.within(&octants).get() };
                match outcome.uniform {
                    Some(value) => {
                        *octant = Octant { link: NONE, payload: Summary::uniform(value) };
                        uniform.push(touch.block);
                    }
                    None => octant.payload = outcome.summary,
                }
            }
            (touched, uniform)
        };
        let parts: Vec<(Touched, Vec<u32>)> = self.touches.list.par_chunks(PER_TASK).zip(self.outcomes.par_chunks(PER_TASK)).map(settle).collect();
        for (part, uniform) in parts {
            touched.append(&part);
            uniform.into_iter().for_each(|block| field.remove(block));
        }
    }
}

/// What `work` gives, and how long it took.
fn timed<T>(work: impl FnOnce() -> T) -> (T, Duration) {
    let start = Instant::now();
    (work(), start.elapsed())
}

/// Everything that a thread needs to update blocks.
struct BlockUpdate<'a> {
    blocks: &'a Pool<OccupancyBlock>,
    voxels: StoreCells<'a, i8>,
    beams: &'a [Beam],
    records: &'a [u64],
    finds: &'a Finds,
    settings: &'a OccupancySettings,
    steps: &'a Steps,
}

/// A share of the blocks.
struct Share<'a> {
    touches: &'a [Touch],
    outcomes: &'a mut [Outcome],
    task: &'a BlockUpdate<'a>,
}

impl Kernel for Share<'_> {
    #[inline(always)]
    fn run(self) {
        let task = self.task;
        let (mut updates, mut free_only) = (Updates::new(task.steps), Updates::new(task.steps));
        let mut formation = Formation::new(task.settings);
        let mut open = None;
        // Beams walk in formation through one block after the other; blocks without beams are done on the way.
        for (number, touch) in self.touches.iter().enumerate() {
            if touch.start == touch.end {
                task.begin(touch, &mut free_only);
                self.outcomes[number] = task.fold(touch, &free_only);
                continue;
            }
            let place = task.place(touch);
            for &record in &task.records[touch.start as usize..touch.end as usize] {
                formation.push(number as u32, place, &task.beams[beam_of(record)]);
                if formation.is_full() {
                    task.land(&mut formation, &mut updates, &mut open, self.touches, self.outcomes);
                }
            }
        }
        task.land(&mut formation, &mut updates, &mut open, self.touches, self.outcomes);
        if let Some(last) = open {
            self.outcomes[last as usize] = task.fold(&self.touches[last as usize], &updates);
        }
    }
}

impl BlockUpdate<'_> {
    #[inline(always)]
    fn place(&self, touch: &Touch) -> Place {
        let block = &self.blocks[touch.block];
        let c = block_coords(block.key);
        let edge = BLOCK_EDGE as i32;
        Place { corner: [(c[0] * edge) as f32, (c[1] * edge) as f32, (c[2] * edge) as f32], scale: usize::from(block.scale) }
    }

    #[inline(always)]
    fn begin(&self, touch: &Touch, updates: &mut Updates<'_>) {
        let free = match touch.free {
            Free::None => FreeVoxels::None,
            Free::All => FreeVoxels::All,
            Free::Mask { heap, mask } => FreeVoxels::Some(&self.finds.heaps[heap as usize].masks[mask as usize]),
        };
        updates.begin(usize::from(self.blocks[touch.block].scale), free);
    }

    /// Notes what a formation passes; `open` is the touch whose updates are being collected.
    #[inline(always)]
    fn land(&self, formation: &mut Formation<'_>, updates: &mut Updates<'_>, open: &mut Option<u32>, touches: &[Touch], outcomes: &mut [Outcome]) {
        for lane in 0..formation.walk() {
            let owner = formation.owner(lane);
            if *open != Some(owner) {
                if let Some(done) = *open {
                    outcomes[done as usize] = self.fold(&touches[done as usize], updates);
                }
                self.begin(&touches[owner as usize], updates);
                *open = Some(owner);
            }
            updates.note(formation, lane);
        }
    }

    #[inline(always)]
    #[allow(unsafe_code)]
    fn fold(&self, touch: &Touch, updates: &Updates<'_>) -> Outcome {
        let block = &self.blocks[touch.block];
        // SAFETY: each block occurs in one touch only, and an array belongs to one block only.
        let values = unsafe { self.voxels.get(usize::from(block.scale), block.slot) };
        updates.fold(usize::from(block.scale), values)
    }
}
