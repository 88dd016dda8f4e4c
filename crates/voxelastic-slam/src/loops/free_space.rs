//! The free-space veto: a closure that puts the surfaces of one place into space that the other has seen to be free is wrong.

use super::place::Place;
use crate::registration::{VoxelIndex, key};
use voxelastic::geometry::{Pose, Rigid};

/// Rays of a place that are followed, at most.
const MOST_RAYS: usize = 8_000;
/// Surfaces of a place that are looked up, at most.
const MOST_POINTS: usize = 8_000;
/// A ray is free up to so many voxels before its return.
const MARGIN: f32 = 2.0;
/// Rays are followed this far, in voxels.
const REACH: f32 = 60.0;
/// Rays that must have passed a voxel for it to be free.
const LEAST_RAYS: u8 = 2;

/// The space that the rays of a place have passed, in voxels.
#[derive(Debug)]
pub(crate) struct FreeSpace {
    voxel: f32,
    index: VoxelIndex,
    passed: Vec<u8>,
    is_surface: Vec<bool>,
}

impl FreeSpace {
    /// The free space of a place, in voxels of edge `voxel`, metres.
    pub(crate) fn new(place: &Place, voxel: f32) -> Self {
        let mut space = Self { voxel, index: VoxelIndex::default(), passed: Vec::new(), is_surface: Vec::new() };
        let rays: usize = place.scans.iter().map(|s| s.points.len()).sum();
        let step = rays.div_ceil(MOST_RAYS).max(1);
        for scan in &place.scans {
            scan.points.iter().step_by(step).for_each(|p| space.follow(scan.origin(), *p));
            for p in &scan.points {
                let at = space.slot(*p);
                space.is_surface[at] = true;
            }
        }
        space
    }

    /// Share of another place's surfaces that lie in this free space, among those in space that this place has seen at all; `None` if there
    /// are too few to say. `t_this_other` puts the other place into this one's frame.
    pub(crate) fn contradiction(&self, other: &Place, t_this_other: &Pose) -> Option<f64> {
        let moved = Rigid::from(t_this_other);
        let points: usize = other.scans.iter().map(|s| s.points.len()).sum();
        let step = points.div_ceil(MOST_POINTS).max(1);
        let (mut seen, mut contradicting) = (0usize, 0usize);
        for p in other.scans.iter().flat_map(|s| s.points.iter().step_by(step)) {
            let p = moved.apply(*p);
            let base = self.coordinates(p);
            if self.is_surface_near(base) {
                seen += 1;
            } else if self.index.get(key(base)).is_some_and(|at| self.passed[at as usize] >= LEAST_RAYS) {
                seen += 1;
                contradicting += 1;
            }
        }
        (seen >= 200).then(|| contradicting as f64 / seen as f64)
    }

    fn coordinates(&self, p: [f32; 3]) -> [i32; 3] {
        p.map(|v| (v / self.voxel).floor() as i32)
    }

    fn slot(&mut self, p: [f32; 3]) -> usize {
        let (at, is_new) = self.index.get_or_insert(key(self.coordinates(p)), self.passed.len() as u32);
        if is_new {
            self.passed.push(0);
            self.is_surface.push(false);
        }
        at as usize
    }

    /// Whether a surface is in a voxel or in one beside it.
    fn is_surface_near(&self, [x, y, z]: [i32; 3]) -> bool {
        let around = (0..27).map(|k| [x + k % 3 - 1, y + k / 3 % 3 - 1, z + k / 9 - 1]);
        around.into_iter().any(|c| self.index.get(key(c)).is_some_and(|at| self.is_surface[at as usize]))
    }

    fn follow(&mut self, origin: [f32; 3], end: [f32; 3]) {
        let d: [f32; 3] = std::array::from_fn(|i| end[i] - origin[i]);
        let length = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
        let until = (length - MARGIN * self.voxel).min(REACH * self.voxel);
        let steps = (until / self.voxel).floor();
        let mut last = [i32::MAX; 3];
        for k in 1..=steps.max(0.0) as usize {
            let t = k as f32 * self.voxel / length;
            let p: [f32; 3] = std::array::from_fn(|i| origin[i] + t * d[i]);
            let here = self.coordinates(p);
            if here != last {
                let at = self.slot(p);
                self.passed[at] = self.passed[at].saturating_add(1);
                last = here;
            }
        }
    }
}
