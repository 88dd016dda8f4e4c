//! The free-space veto: a pose that puts the surfaces of one place into space that another has observed to be free is wrong.

use crate::registration::{VoxelIndex, key};
use voxelastic::geometry::{Pose, Rigid};

/// Rays that are followed, at most: of a scan, and of a place, which is looked at in smaller voxels.
const MOST_RAYS: usize = 8_000;
const MOST_RAYS_OF_PLACE: usize = 60_000;
/// Surfaces of a place that are looked up, at most.
const MOST_POINTS: usize = 8_000;
/// A ray is free up to so many voxels before its return.
const MARGIN: f32 = 2.0;
/// Rays are followed this far, in voxels.
const REACH: f32 = 60.0;
/// Rays that must have passed a voxel for it to be free.
const LEAST_RAYS: u8 = 2;
/// Surfaces in space that was observed, without which nothing can be said.
const LEAST_OBSERVED: usize = 200;

/// Share of the surfaces of one place that lie in space that the other saw to be free, the larger of the two ways, in voxels of edge `voxel`, metres; none where too little of
/// the one is where the other saw anything.
pub(crate) fn contradiction(first: &[View<'_>], second: &[View<'_>], t_first_second: &Pose, voxel: f32) -> Option<f64> {
    let one_way =
        |free: &[View<'_>], surfaces: &[View<'_>], t: &Pose| FreeSpace::with_rays(free, voxel, MOST_RAYS_OF_PLACE).contradiction(surfaces, t);
    Some(one_way(first, second, t_first_second)?.max(one_way(second, first, &t_first_second.inverse())?))
}

/// The returns of a scan.
#[derive(Clone, Copy, Debug)]
pub(crate) struct View<'a> {
    /// Where the sensor was, in the frame of the points.
    pub(crate) origin: [f32; 3],
    pub(crate) points: &'a [[f32; 3]],
}

/// The space that the rays of some scans have passed, in voxels.
#[derive(Debug)]
pub(crate) struct FreeSpace {
    voxel: f32,
    index: VoxelIndex,
    passed: Vec<u8>,
    is_surface: Vec<bool>,
}

impl FreeSpace {
    /// The free space of a scan or two in one frame, in voxels of edge `voxel`, metres.
    pub(crate) fn new(views: &[View<'_>], voxel: f32) -> Self {
        Self::with_rays(views, voxel, MOST_RAYS)
    }

    fn with_rays(views: &[View<'_>], voxel: f32, most: usize) -> Self {
        let mut space = Self { voxel, index: VoxelIndex::default(), passed: Vec::new(), is_surface: Vec::new() };
        let rays: usize = views.iter().map(|view| view.points.len()).sum();
        let step = rays.div_ceil(most).max(1);
        for view in views {
            view.points.iter().step_by(step).for_each(|p| space.follow(view.origin, *p));
            for p in view.points {
                let at = space.slot(*p);
                space.is_surface[at] = true;
            }
        }
        space
    }

    /// Share of the surfaces of other scans that lie in this free space, among those in space that was observed at all; `None` if there
    /// are too few to say. `t_this_other` puts the others into this frame.
    pub(crate) fn contradiction(&self, others: &[View<'_>], t_this_other: &Pose) -> Option<f64> {
        let moved = Rigid::from(t_this_other);
        let points: usize = others.iter().map(|view| view.points.len()).sum();
        let step = points.div_ceil(MOST_POINTS).max(1);
        let (mut observed, mut contradicting) = (0usize, 0usize);
        for p in others.iter().flat_map(|view| view.points.iter().step_by(step)) {
            let p = moved.apply(*p);
            let base = self.coordinates(p);
            if self.is_surface_near(base) {
                observed += 1;
            } else if self.index.get(key(base)).is_some_and(|at| self.passed[at as usize] >= LEAST_RAYS) {
                observed += 1;
                contradicting += 1;
            }
        }
        (observed >= LEAST_OBSERVED).then(|| contradicting as f64 / observed as f64)
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

#[cfg(test)]
#[allow(clippy::print_stdout)]
mod tests {
    use super::*;
    use crate::registration::{Downsampler, automatic_voxel_size};
    use voxelastic::Cloud;
    use voxelastic_sim::random::Stream;
    use voxelastic_sim::{SimOptions, Simulation};

    /// Thinned returns of a scan at a pose of the route, and the size of a voxel.
    fn scan(simulation: &Simulation, pose: &Pose, noise: u64) -> (Vec<[f32; 3]>, f32) {
        let cloud = simulation.lidar().scan(simulation.world(), |_| *pose, &Stream::new(noise, &[1]));
        let returns: Vec<[f32; 3]> = cloud.points.into_iter().filter(Cloud::is_return).collect();
        let voxel = automatic_voxel_size(&returns) as f32;
        let mut thinned = Vec::new();
        Downsampler::default().means(&returns, voxel / 3.0, &mut thinned);
        (thinned, voxel)
    }

    #[test]
    fn shifted_and_mirrored_places_contradict_and_right_ones_do_not() {
        for (world, apart, shift) in [("room", 0.5, 1.5), ("street", 3.0, 6.0), ("campus", 3.0, 6.0)] {
            for seed in 1..5 {
                let simulation = Simulation::new(SimOptions { columns: Some(512), seed, ..SimOptions::of(world) }).unwrap();
                let route = &simulation.scene().trajectory;
                let mut numbers = Stream::new(seed, &[9]);
                let at = numbers.range(0.0, 8.0);
                let (first, second) = (route.pose(at), route.pose(at + apart / route.carrier.speed));
                let (a, voxel) = scan(&simulation, &first, 2 * seed);
                let (b, _) = scan(&simulation, &second, 2 * seed + 1);
                let mirrored: Vec<[f32; 3]> = b.iter().map(|[x, y, z]| [*x, -y, *z]).collect();
                let contradiction = |points: &[[f32; 3]], t: &Pose| {
                    let [a, b] = [&a[..], points].map(|points| [View { origin: [0.0; 3], points }]);
                    let there = FreeSpace::new(&a, voxel).contradiction(&b, t).unwrap();
                    there.max(FreeSpace::new(&b, voxel).contradiction(&a, &t.inverse()).unwrap())
                };
                let right = first.inv_mul(&second);
                let turn = numbers.range(0.0, std::f64::consts::TAU);
                let shifted = Pose::translation(shift * turn.cos(), shift * turn.sin(), 0.0) * right;
                let found = [contradiction(&b, &right), contradiction(&b, &shifted), contradiction(&mirrored, &right)];
                println!("{world} {seed}: right, shifted, mirrored {found:.3?}");
                assert!(found[0] < 0.02 && found[1] > 0.04 && found[2] > 0.04, "{world} {seed}: {found:?}");
            }
        }
    }
}
