//! The update of a TSDF: beams fly through blocks in formation, and what they meet is changed one formation behind.
//!
//! Blocks come one after the other, each with its beams in beam order. Sixteen lines are walked at a time ([`walk`](super::walk)); the
//! bricks that they meet are woken or made, and asked for; then the voxels of the sixteen before them are updated.

use super::band::{Band, HITS_ROOM, Hits, Labels, is_shaded_at, observe_shade};
use super::scale::ScaleRule;
use super::select::beam_of;
use super::transform::Beam;
use super::walk::{LANES, Line, Lines, Trace};
use crate::dispatch::Kernel;
use crate::field::tsdf::brick::{BRICK, BRICKS, Brick, PLACE_BITS};
use crate::field::tsdf::propagate::{children, propagate_delta_down, propagate_down, propagate_up};
use crate::field::tsdf::{Array, Block, OpenField, Touched, Voxel};
use crate::octree::{BLOCK_EDGE, NONE, Place, ask_for_all, block_coords, prefetch, voxels_at};
use std::mem::offset_of;

/// How a block moves between scales in a scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Change {
    None,
    Coarser,
    /// To an array that was there before.
    Finer,
    /// To a new array.
    FinerNew,
}

/// Decides whether `block`, `distance` metres from the sensor, changes scale.
pub(super) fn scale_change(block: &Block, rule: &ScaleRule, distance: f32) -> Change {
    let (current, finest) = (usize::from(block.scale), usize::from(block.finest));
    match rule.next(current, distance) {
        next if next > current => Change::Coarser,
        next if next == current => Change::None,
        next if next < finest => Change::FinerNew,
        _ => Change::Finer,
    }
}

/// A block and the records of the beams that touch it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Run {
    pub block: u32,
    pub start: u32,
    pub end: u32,
    pub change: Change,
    /// The octants in which beams that end there tell something, a bit each.
    pub open: u8,
}

/// The octant of the block with smallest corner `corner` that `point` lies in, as a bit; none outside of the block.
#[inline(always)]
pub(super) fn octant_bit(point: [f32; 3], corner: [f32; 3]) -> u8 {
    let within: [f32; 3] = std::array::from_fn(|k| point[k] - corner[k]);
    let edge = BLOCK_EDGE as f32;
    let octant = (0..3).fold(0, |octant, k| octant | u32::from(within[k] >= edge / 2.0) << k);
    if within.iter().all(|c| (0.0..edge).contains(c)) { 1 << octant } else { 0 }
}

/// Everything that a thread needs to update blocks.
pub(super) struct Update<'a> {
    pub field: OpenField<'a>,
    pub beams: &'a [Beam],
    pub records: &'a [u64],
    pub band: Band,
}

/// A thread's share of the blocks.
pub(super) struct Share<'a> {
    /// Each block occurs once in all shares.
    pub runs: &'a [Run],
    pub task: &'a Update<'a>,
    pub formations: &'a mut Formations,
    pub touched: &'a mut Touched,
}

/// Room for the beams that fly and for those that have just landed. Too large to be made anew for every share.
pub(super) struct Formations([Formation; 2]);

impl Formations {
    pub fn new() -> Self {
        Self([Formation::new(), Formation::new()])
    }
}

/// How far ahead a beam is asked for: records follow blocks, beams lie in the order of the scan.
const BEAMS_AHEAD: usize = 24;
/// How far ahead a block is asked for, and what it has at rest.
const BLOCKS_AHEAD: [usize; 2] = [6, 3];

impl Kernel for Share<'_> {
    #[inline(always)]
    #[allow(unsafe_code)]
    fn run(self) {
        let Self { runs, task, formations: Formations(formations), touched } = self;
        let mut next = 0;
        // Loops, because a closure would not be inlined and then not be compiled for the wide instructions.
        for (i, run) in runs.iter().enumerate() {
            if let Some(later) = runs.get(i + BLOCKS_AHEAD[0]) {
                ask_for_all(task.field.block(later.block).address());
            }
            if let Some(later) = runs.get(i + BLOCKS_AHEAD[1]) {
                // SAFETY: each block occurs in one run only, so in one thread only.
                task.field.ask_for(unsafe { task.field.block(later.block).get() });
            }
            if run.change != Change::None {
                task.change_scale(run, touched);
            }
            task.note_told(run);
            let mut home = task.home(run.block);
            for record in run.start as usize..run.end as usize {
                if let Some(&later) = task.records.get(record + BEAMS_AHEAD) {
                    ask_for_all(&raw const task.beams[beam_of(later)]);
                }
                let beam = &task.beams[beam_of(task.records[record])];
                if run.open != u8::MAX && run.open & octant_bit(beam.point, home.corner) == 0 {
                    continue;
                }
                formations[next].push(&home, beam);
                if formations[next].lines.len() == LANES {
                    if formations[next].walk(task, touched) {
                        home = task.home(run.block);
                    }
                    next = 1 - next;
                    // SAFETY: as above, and bricks belong to one block only.
                    unsafe { formations[next].apply(&task.band) };
                }
            }
        }
        formations[next].walk(task, touched);
        for formation in [1 - next, next] {
            // SAFETY: as above.
            unsafe { formations[formation].apply(&task.band) };
        }
    }
}

/// The block that beams are walked through.
struct Home {
    id: u32,
    scale: u32,
    /// Its first brick at its current scale, among all of its bricks.
    first: usize,
    /// The bricks at that scale; nowhere those that have to be woken first, and missing those that hold nothing.
    bricks: [Place<Brick>; BRICKS],
    shaded: bool,
    /// Its smallest corner, finest voxels.
    corner: [f32; 3],
}

/// Where a label says which of a formation's blocks its line flies through, whether that has intensities, and which line it is.
const HOME_BIT: u32 = PLACE_BITS;
const SHADED_BIT: u32 = 15;
const LANE_BIT: u32 = 16;

/// Beams that are walked together, each through a block of its own or one that it shares.
struct Formation {
    lines: Lines,
    labels: Labels,
    trace: Trace,
    hits: Hits,
    /// The blocks, where their current bricks begin among all of theirs, and where these lie.
    ids: [u32; LANES],
    firsts: [usize; LANES],
    bricks: [Place<Brick>; LANES * BRICKS],
    blocks: usize,
    /// Strength of each return.
    shade: [u8; LANES],
    /// Returns that each beam stands for.
    count: [f32; LANES],
    told: Told,
    shaded: Shaded,
}

/// Voxels that are told something, and what: their distance and its weight.
struct Told {
    voxels: [Place<Voxel>; HITS_ROOM],
    distances: [f32; HITS_ROOM],
    weights: [f32; HITS_ROOM],
    len: usize,
}

/// Intensities that are told one.
struct Shaded {
    places: [Place<u8>; HITS_ROOM],
    observed: [u8; HITS_ROOM],
    len: usize,
}

impl Formation {
    fn new() -> Self {
        Self {
            lines: Lines::new(),
            labels: Labels { fine: [0; LANES], label: [0; LANES] },
            trace: Trace::new(),
            hits: Hits::new(),
            ids: [NONE; LANES],
            firsts: [0; LANES],
            bricks: [Place::NOWHERE; LANES * BRICKS],
            blocks: 0,
            shade: [0; LANES],
            count: [1.0; LANES],
            told: Told { voxels: [Place::NOWHERE; HITS_ROOM], distances: [0.0; HITS_ROOM], weights: [0.0; HITS_ROOM], len: 0 },
            shaded: Shaded { places: [Place::NOWHERE; HITS_ROOM], observed: [0; HITS_ROOM], len: 0 },
        }
    }

    #[inline(always)]
    fn push(&mut self, home: &Home, beam: &Beam) {
        let lane = self.lines.len() % LANES;
        if self.blocks == 0 || self.ids[(self.blocks - 1) % LANES] != home.id {
            let block = self.blocks % LANES;
            (self.ids[block], self.firsts[block]) = (home.id, home.first);
            self.bricks[block * BRICKS..][..BRICKS].copy_from_slice(&home.bricks);
            self.blocks += 1;
        }
        (self.shade[lane], self.count[lane]) = (beam.shade, f32::from(beam.count));
        self.labels.fine[lane] = u32::from(home.scale == 0).wrapping_neg();
        self.labels.label[lane] = (lane as u32) << LANE_BIT | u32::from(home.shaded) << SHADED_BIT | (self.blocks as u32 - 1) << HOME_BIT;
        self.lines.push(&Line {
            point: beam.point,
            direction: beam.direction,
            gradient: beam.normal,
            corner: home.corner,
            scale: home.scale,
            reach: [-beam.reach[0], beam.reach[1]],
        });
    }

    /// Finds out what the lines pass, and asks for it to be brought near. Tells whether bricks were woken or made, which other homes do not know of.
    #[inline(always)]
    fn walk(&mut self, task: &Update<'_>, touched: &mut Touched) -> bool {
        self.trace.walk(&self.lines);
        task.band.collect(&self.trace, &self.labels, &mut self.hits);
        let Self { hits, told, shaded, .. } = self;
        let (mut came, mut tells, mut shades) = (false, 0, 0);
        let found = hits.target.iter().zip(&hits.quantity).zip(&hits.weight);
        for ((&target, &distance), &weight) in found.take(hits.len) {
            let brick = &mut self.bricks[(target / BRICK as u32) as usize % (LANES * BRICKS)];
            if brick.is_nowhere() | ((*brick == Place::MISSING) & task.band.makes(distance)) {
                let block = (target >> HOME_BIT) as usize % LANES;
                *brick = task.brick(self.ids[block], self.firsts[block] + (target / BRICK as u32) as usize % BRICKS, touched);
                came = true;
            }
            let place = target as usize % BRICK;
            let voxel = brick.part::<Voxel>(offset_of!(Brick, voxels) + size_of::<Voxel>() * place);
            let lane = (target >> LANE_BIT) as usize % LANES;
            told.voxels[tells % HITS_ROOM] = voxel;
            told.distances[tells % HITS_ROOM] = distance;
            told.weights[tells % HITS_ROOM] = weight * self.count[lane];
            prefetch(voxel.address());
            let is_there = *brick != Place::MISSING;
            tells += usize::from(is_there);
            shaded.places[shades % HITS_ROOM] = brick.part(offset_of!(Brick, shades) + place);
            shaded.observed[shades % HITS_ROOM] = self.shade[lane];
            shades += usize::from(is_there & is_shaded_at(distance)) & (target >> SHADED_BIT) as usize;
        }
        (told.len, shaded.len) = (tells, shades);
        for place in shaded.places.iter().take(shades) {
            prefetch(place.address());
        }
        came
    }

    /// Updates the voxels that the lines pass, and disbands the formation.
    ///
    /// # Safety
    /// No other thread may touch the bricks of the blocks that the lines were pushed for.
    #[inline(always)]
    #[allow(unsafe_code)]
    unsafe fn apply(&mut self, band: &Band) {
        let Self { told, shaded, .. } = self;
        for ((voxel, &distance), &weight) in told.voxels.iter().zip(&told.distances).zip(&told.weights).take(told.len) {
            // SAFETY: the caller's promise; bricks stay where they are while the field is open.
            band.observe(distance, weight, unsafe { voxel.get() });
        }
        for (place, &observed) in shaded.places.iter().zip(&shaded.observed).take(shaded.len) {
            // SAFETY: as above.
            observe_shade(unsafe { place.get() }, observed);
        }
        (self.hits.len, told.len, shaded.len, self.blocks) = (0, 0, 0, 0);
        self.lines.clear();
    }
}

impl Update<'_> {
    #[inline(always)]
    #[allow(unsafe_code)]
    fn home(&self, id: u32) -> Home {
        // SAFETY: each block occurs in one run only, so in one thread only.
        let block = unsafe { self.field.block(id).get() };
        let corner = block_coords(block.key).map(|c| (c * BLOCK_EDGE as i32) as f32);
        let Block { scale, shaded, .. } = *block;
        let (first, bricks) = (block.current().bricks().start, self.field.bricks(block));
        Home { id, scale: scale.into(), first, bricks, shaded, corner }
    }

    /// Notes how much a block is told; of one that is told of some of its octants only, nothing.
    #[inline(always)]
    #[allow(unsafe_code)]
    fn note_told(&self, run: &Run) {
        if run.open == u8::MAX {
            // SAFETY: each block occurs in one run only, so in one thread only.
            let block = unsafe { self.field.block(run.block).get() };
            block.told = block.told.and(run.end - run.start);
        }
    }

    /// Brick `brick` of block `id`, woken or made.
    #[allow(unsafe_code)]
    #[cold]
    #[inline(never)]
    fn brick(&self, id: u32, brick: usize, touched: &mut Touched) -> Place<Brick> {
        // SAFETY: this thread alone deals with the blocks that lines are pushed for.
        unsafe { self.field.brick(self.field.block(id).get(), id, brick, touched) }
    }

    /// Fills the array of a block's new scale from the one that it leaves (paper Sec. III-A, propagation).
    #[allow(unsafe_code)]
    #[cold]
    #[inline(never)]
    fn change_scale(&self, run: &Run, touched: &mut Touched) {
        // SAFETY: here and below, this block occurs in one run only, so in one thread only.
        let block = unsafe { self.field.block(run.block).get() };
        let scale = usize::from(block.scale);
        let [mut new, mut from, mut past] = [[Voxel::default(); voxels_at(0)]; 3];
        let new = &mut new[..voxels_at(scale)];
        let mut guessed = 0;
        let guesses = self.band.guesses();
        let copy = |array: Array, into: &mut [Voxel; voxels_at(0)]| {
            // SAFETY: as above.
            unsafe { self.field.copy(block, array, &mut into[..voxels_at(array.scale())]) };
        };
        match run.change {
            Change::None => return,
            Change::Coarser => {
                copy(Array::Data(scale - 1), &mut from);
                guessed = propagate_up(&from[..voxels_at(scale - 1)], new, scale - 1);
            }
            Change::Finer => {
                copy(Array::Data(scale + 1), &mut from);
                copy(Array::Past(scale + 1), &mut past);
                // SAFETY: as above.
                unsafe { self.field.copy(block, Array::Data(scale), new) };
                let coarse = ..voxels_at(scale + 1);
                propagate_delta_down(&from[coarse], &past[coarse], new, scale, self.band.max_weight as u16, &guesses);
            }
            Change::FinerNew => {
                copy(Array::Data(scale + 1), &mut from);
                propagate_down(&from[..voxels_at(scale + 1)], new, scale, &guesses);
            }
        }
        let mut shades = [0; voxels_at(0)];
        let shades = &mut shades[..voxels_at(scale)];
        if block.shaded {
            self.change_shades(block, run.change, shades);
        }
        // SAFETY: as above.
        unsafe {
            self.field.store(block, run.block, Array::Data(scale), (new, shades), touched);
            if run.change == Change::Coarser {
                // What a guess turns out to be is nothing that finer voxels could learn from.
                (0..new.len()).filter(|i| guessed >> i & 1 == 1).for_each(|i| new[i] = Voxel::default());
                shades.fill(0);
                self.field.store(block, run.block, Array::Past(scale), (new, shades), touched);
            }
        }
    }

    /// Intensities move between scales by plain copy and mean of what is known.
    #[allow(unsafe_code)]
    fn change_shades(&self, block: &Block, change: Change, shades: &mut [u8]) {
        let scale = usize::from(block.scale);
        let mut from = [0; voxels_at(0)];
        let copy = |scale: usize, into: &mut [u8]| {
            // SAFETY: as in `change_scale`.
            unsafe { self.field.copy_shades(block, scale, into) };
        };
        match change {
            Change::Coarser => {
                copy(scale - 1, &mut from[..voxels_at(scale - 1)]);
                for (i, shade) in shades.iter_mut().enumerate() {
                    let known = || children(i, scale - 1).map(|c| u32::from(from[c])).filter(|&s| s > 0);
                    *shade = (known().sum::<u32>() / known().count().max(1) as u32) as u8;
                }
            }
            Change::FinerNew => {
                copy(scale + 1, &mut from[..voxels_at(scale + 1)]);
                for (i, &shade) in from[..voxels_at(scale + 1)].iter().enumerate() {
                    children(i, scale).for_each(|c| shades[c] = shade);
                }
            }
            Change::None | Change::Finer => copy(scale, shades),
        }
    }
}
