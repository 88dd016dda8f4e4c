//! What the other submaps know around contested voxels.

use crate::atlas::fusion::placement::{MARGIN, Placement, floor};
use crate::field::occupancy::{OccupancyField, OccupancyWindow, UNKNOWN};
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, block_coords};
use crate::simd::bits::lowest_bits;
use crate::simd::{Kernel, dispatch};
use std::cell::OnceCell;

/// Largest distance between a contested voxel and another submap's surface that may be the same surface, finest voxels.
pub(crate) const SURFACE_TOLERANCE: f32 = 3.0;

/// Windows on submaps, and where these lie.
type Windows<'a> = Vec<(&'a Placement, OccupancyWindow<'a>)>;

/// Another submap and its placement in the contested one.
pub(crate) struct Voter<'a> {
    pub field: &'a OccupancyField,
    pub placement: Placement,
}

/// The other submaps in and around an octant, looked up when they are first needed.
pub(crate) struct Neighbours<'a, 's> {
    voters: &'s [&'a Voter<'a>],
    /// Centre of the octant and half of its edge, finest voxels.
    centre: [f32; 3],
    half: f32,
    max_contested: i8,
    all: OnceCell<Windows<'a>>,
    /// What may have a value above `max_contested`, also within the tolerance around the octant.
    surfaces: OnceCell<Windows<'a>>,
}

impl<'a, 's> Neighbours<'a, 's> {
    /// Those of `voters` around the octant of `level` that starts at block `key`.
    pub fn around(voters: &'s [&'a Voter<'a>], key: u64, level: u32, max_contested: i8) -> Self {
        let half = 0.5 * (BLOCK_EDGE << level) as f32;
        let centre = block_coords(key).map(|c| (c * BLOCK_EDGE as i32) as f32 + half);
        Self { voters, centre, half, max_contested, all: OnceCell::new(), surfaces: OnceCell::new() }
    }

    /// Windows on what has values above `least` within `margin` voxels.
    fn windows(&self, margin: f32, least: i8) -> Windows<'a> {
        let window = |v: &&'a Voter<'a>| {
            let blocks = v.placement.blocks_in_source(self.centre, self.half + margin);
            OccupancyWindow::new(v.field, &blocks, least).map(|window| (&v.placement, window))
        };
        self.voters.iter().filter_map(window).collect()
    }

    /// Whether any submap has a value above `max_contested` within the tolerance around the finest voxel at `centre`.
    pub fn has_surface_near(&self, centre: [f32; 3]) -> bool {
        self.surfaces.get_or_init(|| self.windows(SURFACE_TOLERANCE, self.max_contested)).iter().any(|(placement, window)| {
            let t = &placement.t_source_target;
            let reach = t.rotation.map(|row| row.iter().map(|r| r.abs()).sum::<f32>() * (0.5 + SURFACE_TOLERANCE) + MARGIN);
            let is_occupied =
                |[x, y, z]: [f32; 3]| window.value(t.apply([centre[0] + x, centre[1] + y, centre[2] + z]).map(floor)) > self.max_contested;
            let middle = t.apply(centre);
            let corner = |sign: f32| std::array::from_fn(|k| floor(middle[k] + sign * reach[k]));
            window.has_blocks_in(corner(-1.0), corner(1.0))
                && [0.5, 0.5 + 0.5 * SURFACE_TOLERANCE, 0.5 + SURFACE_TOLERANCE]
                    .into_iter()
                    .any(|r| (0..27).filter(|i| *i != 13).any(|i| is_occupied([i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1].map(|d| d as f32 * r))))
        })
    }
}

/// Values of the other submaps in a block.
pub(crate) struct Evidence<'a, 'w> {
    /// The block's first corner, finest voxels of the contested submap.
    corner: [f32; 3],
    /// Submaps whose values vary there.
    windows: Vec<(&'a Placement, &'w OccupancyWindow<'a>)>,
    /// Sum of the values of the submaps that have one value there.
    uniform: i32,
}

impl<'a, 'w> Evidence<'a, 'w> {
    /// Evidence in the block whose first corner is at `corner`.
    pub fn in_block(neighbours: &'w Neighbours<'a, '_>, corner: [f32; 3]) -> Self {
        let half = 0.5 * BLOCK_EDGE as f32;
        let mut evidence = Self { corner, windows: Vec::new(), uniform: 0 };
        for (placement, window) in neighbours.all.get_or_init(|| neighbours.windows(0.0, UNKNOWN)) {
            match window.uniform_in(&placement.blocks_in_source(corner.map(|c| c + half), half)) {
                Some(UNKNOWN) => {}
                Some(value) => evidence.uniform += i32::from(value),
                None => evidence.windows.push((placement, window)),
            }
        }
        evidence
    }

    /// Sum of the values at `p`, finest voxels of the contested submap.
    #[inline(always)]
    pub fn sum_at(&self, p: [f32; 3]) -> i32 {
        let values = self.windows.iter().map(|(placement, window)| window.value(placement.t_source_target.apply(p).map(floor)));
        self.uniform + values.filter(|v| *v != UNKNOWN).map(i32::from).sum::<i32>()
    }

    /// Calls `outvoted` with the index of each voxel of the block that has a value from 1 to `max_contested` and the sum at whose centre is
    /// below the negative of that.
    pub fn for_each_outvoted(&self, values: &[i8], scale: usize, max_contested: i8, mut outvoted: impl FnMut(usize)) {
        let (mut contested, mut sums) = ([0; LANES], [0; LANES]);
        let mut count = 0;
        let mut judge = |contested: &[u16; LANES], count: usize| {
            dispatch(SumAtCentres { evidence: self, scale, voxels: contested, sums: &mut sums });
            let is_outvoted = |(voxel, sum): &(&u16, &i32)| i32::from(values[usize::from(**voxel)]) + **sum < 0;
            contested[..count].iter().zip(&sums).filter(is_outvoted).for_each(|(voxel, _)| outvoted(usize::from(*voxel)));
        };
        for (first, values) in (0u16..).step_by(EIGHT).zip(values.chunks(EIGHT)) {
            let mut bytes = [0; EIGHT];
            for (byte, value) in bytes.iter_mut().zip(values) {
                *byte = u8::from((1..=max_contested).contains(value));
            }
            let mut left = lowest_bits(u64::from_le_bytes(bytes));
            while left != 0 {
                contested[count] = first + left.trailing_zeros() as u16;
                count += 1;
                left &= left - 1;
                if count == LANES {
                    judge(&contested, count);
                    count = 0;
                }
            }
        }
        if count > 0 {
            // What is left in the lanes behind them are voxels of the block, too.
            judge(&contested, count);
        }
    }
}

/// Values that are compared at once.
const EIGHT: usize = 8;
/// Voxels whose places are computed together.
const LANES: usize = 16;

/// The sums at the centres of `voxels`, indices in a block at `scale`.
struct SumAtCentres<'e, 'a, 'w> {
    evidence: &'e Evidence<'a, 'w>,
    scale: usize,
    voxels: &'e [u16; LANES],
    sums: &'e mut [i32; LANES],
}

impl Kernel for SumAtCentres<'_, '_, '_> {
    #[inline(always)]
    fn run(self) {
        let Self { evidence, scale, voxels, sums } = self;
        let (corner, edge) = (evidence.corner, (1 << scale) as f32);
        let shift = BLOCK_SHIFT - scale as u32;
        let mask = (BLOCK_EDGE as u32 >> scale) - 1;
        *sums = [evidence.uniform; LANES];
        for (placement, window) in &evidence.windows {
            let mut places = [0; LANES];
            for (place, voxel) in places.iter_mut().zip(voxels) {
                let i = u32::from(*voxel);
                let c = [i & mask, i >> shift & mask, i >> (2 * shift) & mask];
                let centre = std::array::from_fn(|k| corner[k] + (c[k] as i32 as f32 + 0.5) * edge);
                *place = window.place(placement.t_source_target.apply(centre));
            }
            for (sum, place) in sums.iter_mut().zip(places) {
                let value = window.value_at(place);
                *sum += if value == UNKNOWN { 0 } else { i32::from(value) };
            }
        }
    }
}
