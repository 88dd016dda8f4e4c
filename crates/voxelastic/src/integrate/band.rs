//! What a beam tells the voxels of its truncation band.
#![allow(clippy::needless_range_loop)] // A lane is an index into many arrays here.

use super::walk::{LANES, MAX_STEPS, Trace};
use crate::field::tsdf::brick::place;
use crate::field::tsdf::propagate::{GUESSED_WEIGHT, Guesses};
use crate::field::tsdf::{DISTANCE_STEPS, Voxel};

/// The truncation band and the weights of a TSDF update.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Band {
    /// How far the band reaches in front of the surface, in voxels of the block's scale.
    pub before: f32,
    /// How far in front of it voxels are made: farther ones learn only if they are there.
    pub new: f32,
    /// How far behind it.
    pub behind: f32,
    /// What the weight of an observation falls by behind it, of the whole, a voxel.
    pub fade: f32,
    /// Weight of an observation in front of the surface.
    pub weight: f32,
    /// Cap of a voxel's weight.
    pub max_weight: f32,
}

impl Band {
    /// Weight of an observation at `distance` voxels: full down to one voxel behind the surface, then falling to zero at
    /// the end of the band, because what lies behind a surface is a guess (Bylow et al., RSS 2013).
    #[inline(always)]
    pub fn weight_at(&self, distance: f32) -> f32 {
        let fade = (self.behind + distance) * self.fade;
        self.weight * if fade < 1.0 { fade } else { 1.0 }
    }

    /// Collects what lines tell the voxels that they pass, line by line.
    ///
    /// A voxel that the beam's line passes through within the band sees the distance from its centre to the local plane
    /// at the beam's point, not the distance along the beam: the centre is rarely on the line.
    ///
    /// How many voxels a line passes is as good as random. So nothing loops over them, and nothing branches on whether one is within the
    /// band: what is not is written where nobody looks.
    #[inline(always)]
    pub fn collect(&self, trace: &Trace, labels: &Labels, hits: &mut Hits) {
        let (mut counts, mut is_hit) = ([0u32; LANES], [[0u32; LANES]; MAX_STEPS]);
        for (step, is_hit) in is_hit.iter_mut().enumerate().take(trace.longest) {
            for lane in 0..LANES {
                is_hit[lane] = self.is_hit(trace, step, lane);
                counts[lane] += is_hit[lane];
            }
        }
        let mut next = [0u32; LANES];
        for lane in 1..LANES {
            next[lane] = next[lane - 1] + counts[lane - 1];
        }
        hits.len = (next[LANES - 1] + counts[LANES - 1]) as usize;
        for (step, is_hit) in is_hit.iter().enumerate().take(trace.longest) {
            let (mut to, mut hit) = ([0u32; LANES], [0u64; LANES]);
            for lane in 0..LANES {
                to[lane] = if is_hit[lane] == 1 { next[lane] } else { Hits::MOST as u32 };
                next[lane] += is_hit[lane];
                let target = labels.label[lane] | place(labels.fine[lane], trace.index[step][lane]);
                hit[lane] = u64::from(target) | u64::from(trace.quantity[step][lane].to_bits()) << 32;
            }
            for lane in 0..LANES {
                hits.all[to[lane] as usize % HITS_ROOM] = Hit(hit[lane]);
            }
        }
    }

    /// 1 if the line of `lane` tells something to the voxel that it passes in `step`, else 0.
    #[inline(always)]
    fn is_hit(&self, trace: &Trace, step: usize, lane: usize) -> u32 {
        let d = trace.quantity[step][lane];
        let is_alive = (step as u32) < trace.steps[lane];
        u32::from(is_alive & (d < self.before) & (d > -self.behind) & (self.weight_at(d) >= 1.0))
    }

    /// Whether an observation at `distance` voxels makes its voxel if it was never seen.
    #[inline(always)]
    pub fn makes(&self, distance: f32) -> bool {
        distance < self.new
    }

    /// What finer voxels are given that nobody measured.
    pub fn guesses(&self) -> Guesses {
        Guesses { weight: GUESSED_WEIGHT, band: [-self.behind, self.new].map(|voxels| (voxels * DISTANCE_STEPS) as i16) }
    }

    /// Folds an observation at `distance` voxels into its voxel.
    #[inline(always)]
    pub fn observe(&self, distance: f32, weight: f32, voxel: &mut Voxel) {
        // By a mask: which voxels are there is as good as random.
        let told = u32::from(voxel.is_observed() | self.makes(distance));
        let weight = f32::from_bits(weight.to_bits() & told.wrapping_neg());
        voxel.observe(distance * DISTANCE_STEPS, weight, self.max_weight);
    }
}

/// What there is to know about the lines of a formation when one of them meets a voxel.
#[derive(Clone, Debug)]
pub(crate) struct Labels {
    /// All bits set for a line through a block at scale 0, none for others.
    pub fine: [u32; LANES],
    /// Bits above those of a [`place`], as the formation likes.
    pub label: [u32; LANES],
}

/// What lines tell voxels, see [`Band::collect`].
#[derive(Clone, Debug)]
pub(crate) struct Hits {
    /// As many as `len` says, line by line.
    pub all: [Hit; HITS_ROOM],
    pub len: usize,
}

/// What a line tells a voxel, in one word that is written at once: its target, and above that the bits of the distance.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hit(u64);

impl Hit {
    /// The voxel's [`place`] among the bricks of its block, and above it the label of the line.
    #[inline(always)]
    pub fn target(self) -> u32 {
        self.0 as u32
    }

    /// Distance from the voxel's centre to the plane, voxels.
    #[inline(always)]
    pub fn distance(self) -> f32 {
        f32::from_bits((self.0 >> 32) as u32)
    }
}

/// Room for all hits, and for what nobody looks at; a power of two, so that no index needs a test.
pub(crate) const HITS_ROOM: usize = (Hits::MOST + 1).next_power_of_two();

impl Hits {
    /// Most voxels that the lines of a formation pass.
    const MOST: usize = LANES * MAX_STEPS;

    pub fn new() -> Self {
        Self { all: [Hit(0); HITS_ROOM], len: 0 }
    }
}

/// Whether a voxel `distance` voxels from the surface takes an intensity.
#[inline(always)]
pub(crate) fn is_shaded_at(distance: f32) -> bool {
    distance.abs() < SHADED
}

/// How far from the surface voxels have an intensity, in voxels: a vertex has that of the voxel beside it.
const SHADED: f32 = 1.5;

/// Moves an intensity, 0 while it is unknown, an eighth of the way to the observed one, and at least by one.
#[inline(always)]
pub(crate) fn observe_shade(shade: &mut u8, observed: u8) {
    let (old, observed) = (i32::from(*shade), i32::from(observed));
    let change = observed - old;
    // Shifting rounds downwards: away from zero where it is negative, and where it is positive with what is added.
    let moved = old + ((change + if change > 0 { 7 } else { 0 }) >> 3);
    *shade = (if old == 0 { observed } else { moved }) as u8;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intensities_come_to_what_is_observed() {
        for (first, then) in [(1, 255), (255, 1), (100, 101), (101, 100), (7, 7)] {
            let mut shade = 0;
            observe_shade(&mut shade, first);
            assert_eq!(shade, first);
            let mut before = shade;
            for _ in 0..60 {
                observe_shade(&mut shade, then);
                assert!(shade.abs_diff(then) < before.abs_diff(then) || shade == then);
                before = shade;
            }
            assert_eq!(shade, then);
        }
    }
}
