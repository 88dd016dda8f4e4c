//! Where scans take turns: patches of a scan in which the map knows all surfaces well.
//!
//! A scan should cost what it adds. Ten scans a second see nearly the same; of surfaces that many rays have met, each scan then uses a part of its returns, with a
//! weight of so many scans as take turns. What was seen seldom, from farther away or not where the map has its surface is not known, so that all returns of such a
//! patch are used: a map is as complete as with all returns, and things that came, went or moved show at once.

use crate::field::tsdf::{Block, DISTANCE_STEPS, TsdfField, Voxel, WEIGHT_ONE};
use crate::integrate::rays::scale::{ScaleRule, distance_to_block};
use crate::integrate::rays::transform::RayFrame;
use crate::octree::{BLOCK_EDGE, Cursor, MAX_BLOCK_COORD, block_key, voxel_index};
use crate::sensor::{PatchWeights, PixelRow, Returns};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU16, Ordering};

/// Pixels of a row of which one is looked up.
const PIXELS_PER_SAMPLE: usize = 32;
/// A patch is known if at most one in so many samples is not, and all were observed.
const SAMPLES_PER_EXCEPTION: u16 = 4;
/// Number of scans that take turns where a surface is known, and how many times as many rays must have met it.
const SHARING: [(u8, f32); 2] = [(4, 1.0), (8, 2.0)];
/// Returns of one task.
const CHUNK: usize = 8192;

/// What is needed to look up the returns of a scan in a field.
#[derive(Clone, Copy, Debug)]
pub(crate) struct KnownSurfaces<'a> {
    pub field: &'a TsdfField,
    pub frame: RayFrame,
    pub rule: ScaleRule,
    /// A surface is known when so many rays have met it.
    pub known_after: f32,
}

impl KnownSurfaces<'_> {
    /// The weights of the returns of a scan with an image of `size` rows and columns; `turn` is the number of the scan. `None` if all are 1.
    pub fn weights(&self, returns: &Returns, size: (usize, usize), turn: usize) -> Option<PatchWeights> {
        if self.known_after <= 0.0 || self.field.ids().is_empty() {
            return None;
        }
        let counts: Vec<PatchCounts> = (0..PatchWeights::count(size)).map(|_| PatchCounts::default()).collect();
        returns.points.par_chunks(CHUNK).zip(returns.pixel.par_chunks(CHUNK)).for_each(|(points, pixels)| {
            let (mut cursor, mut row) = (Cursor::new(self.field.tree()), PixelRow::new(size.1));
            for (&point, &pixel) in points.iter().zip(pixels) {
                let place = row.place(pixel as usize);
                // Other pixels in each row and scan.
                if (place.1 + 3 * place.0 + turn).is_multiple_of(PIXELS_PER_SAMPLE) {
                    counts[PatchWeights::patch_of(size.1, place)].add(self.rays_at(&mut cursor, point), self.known_after);
                }
            }
        });
        Some(PatchWeights::new(size, turn, |patch| counts[patch].sharing())).filter(|weights| !weights.are_equal())
    }

    /// Number of rays that have met the surface at `point`, lidar frame, metres; 0 if another surface is near, and `None` if the place was never observed, or
    /// never from so near.
    #[inline(always)]
    fn rays_at(&self, cursor: &mut Cursor, point: [f32; 3]) -> Option<f32> {
        let point = self.frame.t_submap_lidar.apply(point).map(|c| c / self.frame.voxel);
        let coords = point.map(|c| (c / BLOCK_EDGE as f32).floor() as i32);
        if coords.iter().any(|c| c.abs() >= MAX_BLOCK_COORD) {
            return None;
        }
        let block = self.field.block(cursor.block(self.field.tree(), block_key(coords))?);
        let distance = distance_to_block(coords, BLOCK_EDGE as f32 * self.frame.voxel, self.frame.t_submap_lidar.translation);
        if self.rule.next(block.scale.into(), distance) < usize::from(block.scale) {
            return None;
        }
        let voxel = Some(self.voxel_at(block, point, coords)).filter(|voxel| voxel.is_observed())?;
        let is_near = f32::from(voxel.distance).abs() < DISTANCE_STEPS;
        Some(if is_near { f32::from(voxel.weight) / f32::from(WEIGHT_ONE) } else { 0.0 })
    }

    /// The voxel of `block` around `point`, finest voxels.
    #[inline(always)]
    fn voxel_at(&self, block: &Block, point: [f32; 3], coords: [i32; 3]) -> Voxel {
        let scale = usize::from(block.scale);
        // Rounding may put a point on the far face.
        let place = |k: usize| ((point[k] - (coords[k] * BLOCK_EDGE as i32) as f32).max(0.0) as usize).min(BLOCK_EDGE - 1) >> scale;
        self.field.voxel(block, voxel_index([place(0), place(1), place(2)], scale))
    }
}

/// Samples of a patch: all, those where nothing was observed, and those that are known, by the number of scans that take turns.
#[derive(Debug, Default)]
struct PatchCounts {
    all: AtomicU16,
    new: AtomicU16,
    known: [AtomicU16; SHARING.len()],
}

impl PatchCounts {
    /// Adds a sample at a surface that so many rays have met.
    #[inline(always)]
    fn add(&self, rays: Option<f32>, known_after: f32) {
        let count = |counter: &AtomicU16, counts: bool| counter.fetch_add(u16::from(counts), Ordering::Relaxed);
        count(&self.all, true);
        count(&self.new, rays.is_none());
        for (known, (_, times)) in self.known.iter().zip(SHARING) {
            count(known, rays.is_some_and(|rays| rays >= times * known_after));
        }
    }

    /// Number of scans that take turns in the patch.
    fn sharing(&self) -> u8 {
        let [all, new] = [&self.all, &self.new].map(|count| count.load(Ordering::Relaxed));
        let is_known = |known: &AtomicU16| all > 0 && new == 0 && (all - known.load(Ordering::Relaxed)) * SAMPLES_PER_EXCEPTION <= all;
        self.known.iter().zip(SHARING).rev().find(|(known, _)| is_known(known)).map_or(1, |(_, (scans, _))| scans)
    }
}
