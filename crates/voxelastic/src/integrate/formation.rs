//! The update of a TSDF: beams fly through blocks in formation, and what they meet is changed one formation behind.
//!
//! Blocks come one after the other, each with its beams in beam order. Sixteen lines are walked at a time ([`walk`](super::walk)); the
//! bricks that they meet are woken or made, and asked for, while the voxels of the sixteen before them are updated.

use super::band::{Band, HITS_ROOM, Hits, Labels, is_shaded_at, observe_shade};
use super::rescale::Change;
use super::select::beam_of;
use super::transform::Beam;
use super::walk::{LANES, Line, Lines, Trace};
use crate::dispatch::Kernel;
use crate::field::tsdf::brick::{BRICK, BRICKS, Brick, PLACE_BITS};
use crate::field::tsdf::{Block, OpenField, Touched, Voxel};
use crate::octree::{BLOCK_EDGE, NONE, Place, ask_for_all, block_coords, prefetch};
use std::mem::offset_of;

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
        let [mut filling, mut before] = formations.each_mut();
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
                filling.push(&home, beam);
                if filling.lines.len() == LANES {
                    // SAFETY: as above, and bricks belong to one block only.
                    if unsafe { filling.walk(before, task, touched) } {
                        home = task.home(run.block);
                    }
                    std::mem::swap(&mut filling, &mut before);
                }
            }
        }
        // SAFETY: as above.
        unsafe {
            filling.walk(before, task, touched);
            filling.apply(&task.band);
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

    /// Finds out what the lines pass and asks for it to be brought near, while what the formation `before` asked for is updated, which disbands.
    /// Tells whether bricks were woken or made, which other homes do not know of.
    ///
    /// # Safety
    /// As for [`apply`](Self::apply).
    #[inline(always)]
    #[allow(unsafe_code)]
    unsafe fn walk(&mut self, before: &mut Self, task: &Update<'_>, touched: &mut Touched) -> bool {
        self.trace.walk(&self.lines);
        task.band.collect(&self.trace, &self.labels, &mut self.hits);
        // By turns: who asks for many lines of memory at once waits for the first of them.
        let both = self.hits.len.min(before.hits.len);
        let mut came = false;
        for i in 0..both {
            came |= self.find(i, task, touched);
            // SAFETY: the caller's promise.
            unsafe { before.tell(i, &task.band) };
        }
        for i in both..self.hits.len {
            came |= self.find(i, task, touched);
        }
        // SAFETY: the caller's promise.
        unsafe { before.apply_from(both, &task.band) };
        came
    }

    /// Finds the brick of hit `i`, wakes or makes it if it has to be, and asks for the voxel. Tells whether it had to be.
    #[inline(always)]
    fn find(&mut self, i: usize, task: &Update<'_>, touched: &mut Touched) -> bool {
        let hit = self.hits.all[i % HITS_ROOM];
        let (target, entry) = (hit.target(), entry_of(hit.target()));
        let (mut brick, mut came) = (self.bricks[entry], false);
        if !brick.is_somewhere() {
            if brick == Place::MISSING && !task.band.makes(hit.distance()) {
                return false;
            }
            let block = (target >> HOME_BIT) as usize % LANES;
            brick = task.brick(self.ids[block], self.firsts[block] + entry % BRICKS, touched);
            (self.bricks[entry], came) = (brick, true);
        }
        let place = target as usize % BRICK;
        prefetch(voxel_in(brick, place).address());
        if is_shaded(target) {
            prefetch(shade_in(brick, place).address());
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
        // SAFETY: the caller's promise.
        unsafe { self.apply_from(0, band) }
    }

    /// The same, of which the first hits were told before.
    ///
    /// # Safety
    /// As for [`apply`](Self::apply).
    #[inline(always)]
    #[allow(unsafe_code)]
    unsafe fn apply_from(&mut self, first: usize, band: &Band) {
        for i in first..self.hits.len {
            // SAFETY: the caller's promise.
            unsafe { self.tell(i, band) };
        }
        (self.hits.len, self.blocks) = (0, 0);
        self.lines.clear();
    }

    /// Updates the voxel of hit `i`, and its intensity. Of a brick that was left missing it does nothing.
    ///
    /// # Safety
    /// As for [`apply`](Self::apply).
    #[inline(always)]
    #[allow(unsafe_code)]
    unsafe fn tell(&mut self, i: usize, band: &Band) {
        let hit = self.hits.all[i % HITS_ROOM];
        let (target, distance) = (hit.target(), hit.distance());
        let brick = self.bricks[entry_of(target)];
        if !brick.is_somewhere() {
            return;
        }
        let (place, lane) = (target as usize % BRICK, (target >> LANE_BIT) as usize % LANES);
        let weight = band.weight_at(distance) * self.count[lane];
        // SAFETY: the caller's promise; bricks stay where they are while the field is open.
        band.observe(distance, weight, unsafe { voxel_in(brick, place).get() });
        if is_shaded(target) {
            // SAFETY: as above.
            let shade = unsafe { shade_in(brick, place).get() };
            let mut moved = *shade;
            observe_shade(&mut moved, self.shade[lane]);
            // By selection: most voxels take one, and which is as good as random.
            *shade = if is_shaded_at(distance) { moved } else { *shade };
        }
    }
}

/// Where a formation has the brick that a hit with this target falls into.
#[inline(always)]
fn entry_of(target: u32) -> usize {
    (target / BRICK as u32) as usize % (LANES * BRICKS)
}

/// Whether the block of a hit with this target has intensities.
#[inline(always)]
fn is_shaded(target: u32) -> bool {
    target >> SHADED_BIT & 1 == 1
}

/// Where voxel `place` of a brick lies.
#[inline(always)]
fn voxel_in(brick: Place<Brick>, place: usize) -> Place<Voxel> {
    brick.part(offset_of!(Brick, voxels) + size_of::<Voxel>() * place)
}

/// Where its intensity lies.
#[inline(always)]
fn shade_in(brick: Place<Brick>, place: usize) -> Place<u8> {
    brick.part(offset_of!(Brick, shades) + place)
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
}
