//! Distances and gradients at many points: sorted by where they are, so that a block is looked up and decoded once for all points near it.

use super::DistanceQuery;
use super::block_window::{BlockBox, BlockWindow, Reach};
use super::point_order::{Cells, FEW};
use super::surface_distance::{Placement, SurfaceDistance, trilinear};
use crate::field::tsdf::TsdfField;
use crate::geometry::Pose;
use crate::octree::BLOCK_EDGE;
use crate::simd::{Kernel, dispatch};
use rayon::prelude::*;

/// Points that are computed together, one vector lane each.
const LANES: usize = 64;

impl DistanceQuery<'_> {
    /// The field at each of `points` (metres, map frame), as [`sample`](Self::sample) gives it.
    ///
    /// ```
    /// use voxelastic::atlas::Atlas;
    /// use voxelastic::query::DistanceQuery;
    /// let atlas = Atlas::new(0.065);
    /// assert_eq!(DistanceQuery::new(&atlas).sample_many(&[[0.0f32; 3]; 5]), [None; 5]);
    /// ```
    pub fn sample_many<T: Copy + Into<f64> + Sync>(&self, points: &[[T; 3]]) -> Vec<Option<SurfaceDistance>> {
        self.answer(points)
    }

    /// The distance at each of `points` (metres, map frame), as [`sample`](Self::sample) gives it; NaN where that is none. Faster than
    /// [`sample_many`](Self::sample_many), which computes gradients, too.
    ///
    /// ```
    /// use voxelastic::atlas::Atlas;
    /// use voxelastic::query::DistanceQuery;
    /// let atlas = Atlas::new(0.065);
    /// assert!(DistanceQuery::new(&atlas).sample_distances(&[[0.0f32; 3]; 5]).iter().all(|distance| distance.is_nan()));
    /// ```
    pub fn sample_distances<T: Copy + Into<f64> + Sync>(&self, points: &[[T; 3]]) -> Vec<f32> {
        self.answer(points)
    }

    fn answer<T: Copy + Into<f64> + Sync, A: Answer>(&self, points: &[[T; 3]]) -> Vec<A> {
        if points.len() < FEW {
            return points.par_iter().with_min_len(64).map(|p| A::of(self.sample(p.map(Into::into)))).collect();
        }
        let mut cells = Cells::new(BLOCK_EDGE as f64 * self.voxel);
        let fields: Vec<PlacedField<'_>> = self.parts.iter().filter_map(PlacedField::new).collect();
        for field in &fields {
            let [low, high] = [field.blocks.low, field.blocks.high.map(|c| c + 1)].map(|c| c.map(|c| f64::from(c) * BLOCK_EDGE as f64 * self.voxel));
            cells.cover(low, high, &field.t_submap_map.inverse());
        }
        let look_up = |window: &mut BlockWindow, points: &[[f64; 3]], answers: &mut [A]| {
            A::sample(SampleTask { fields: &fields, voxel: self.voxel, points, answers, window });
        };
        cells.answer(points, A::UNKNOWN, BlockWindow::new, look_up)
    }
}

/// A field, where it is, and the box of its blocks.
struct PlacedField<'a> {
    field: &'a TsdfField,
    t_submap_map: Pose,
    placement: Placement,
    blocks: BlockBox,
}

impl<'a> PlacedField<'a> {
    /// None for a field without blocks.
    fn new((field, t_submap_map): &(&'a TsdfField, Pose)) -> Option<Self> {
        let blocks = BlockBox::of(field)?;
        Some(Self { field, t_submap_map: *t_submap_map, placement: Placement::new(t_submap_map), blocks })
    }
}

/// What is kept of a sample.
trait Answer: Copy + Send + Sync {
    /// Where no submap has an observed voxel.
    const UNKNOWN: Self;

    fn of(sample: Option<SurfaceDistance>) -> Self;

    /// Does a task. Not generic, so that it is compiled here and not with the crate that asks.
    fn sample(task: SampleTask<'_, Self>);

    /// Takes another distance, if it is known and nearer to zero: the first of equals stays.
    fn take_nearer(&mut self, distance: f32, gradient: impl FnOnce() -> [f32; 3]);
}

impl Answer for f32 {
    const UNKNOWN: Self = Self::NAN;

    fn of(sample: Option<SurfaceDistance>) -> Self {
        sample.map_or(Self::NAN, |sample| sample.distance)
    }

    fn sample(task: SampleTask<'_, Self>) {
        dispatch(task);
    }

    #[inline(always)]
    fn take_nearer(&mut self, distance: f32, _: impl FnOnce() -> [f32; 3]) {
        *self = if is_nearer(distance, *self) { distance } else { *self };
    }
}

impl Answer for Option<SurfaceDistance> {
    const UNKNOWN: Self = None;

    fn of(sample: Option<SurfaceDistance>) -> Self {
        sample
    }

    fn sample(task: SampleTask<'_, Self>) {
        dispatch(task);
    }

    #[inline(always)]
    fn take_nearer(&mut self, distance: f32, gradient: impl FnOnce() -> [f32; 3]) {
        if is_nearer(distance, self.map_or(f32::NAN, |sample| sample.distance)) {
            *self = Some(SurfaceDistance { distance, gradient: gradient() });
        }
    }
}

/// Whether `distance` is known, and nearer to zero than `other` if that is known.
#[inline(always)]
fn is_nearer(distance: f32, other: f32) -> bool {
    !distance.is_nan() & (other.is_nan() | (distance.abs() < other.abs()))
}

/// Points near each other, to look up in all fields.
struct SampleTask<'a, A> {
    fields: &'a [PlacedField<'a>],
    voxel: f64,
    points: &'a [[f64; 3]],
    answers: &'a mut [A],
    window: &'a mut BlockWindow,
}

impl<A: Answer> Kernel for SampleTask<'_, A> {
    #[inline(always)]
    fn run(self) {
        let Self { fields, voxel, points, answers, window } = self;
        for field in fields {
            let mut sampler = Sampler { field, voxel, window: &mut *window };
            // One by one if they are too far apart, as in a map that is larger than the grid of points can be.
            let together = if sampler.reach(points) == Reach::TooMuch { 1 } else { points.len() };
            for (points, answers) in points.chunks(together).zip(answers.chunks_mut(together)) {
                if sampler.enter(points) {
                    points.chunks(LANES).zip(answers.chunks_mut(LANES)).for_each(|(points, answers)| sampler.sample(points, answers));
                }
            }
        }
    }
}

/// Samples a field at points that a window reaches.
struct Sampler<'a, 'w> {
    field: &'a PlacedField<'a>,
    voxel: f64,
    window: &'w mut BlockWindow,
}

/// Of each lane: the coordinates of the lower and of the upper corners of its cell, as parts of the index of a block and of a voxel in it; by axis.
struct Corners {
    block: [[[u32; LANES]; 3]; 2],
    voxel: [[[u32; LANES]; 3]; 2],
}

impl Sampler<'_, '_> {
    /// What a window around `points` would hold.
    #[inline(always)]
    fn reach(&self, points: &[[f64; 3]]) -> Reach {
        let (low, high) = self.voxels_around(points);
        BlockWindow::reach(&self.field.blocks, low, high)
    }

    /// Moves the window to `points`. False if the field has no blocks there.
    #[inline(always)]
    fn enter(&mut self, points: &[[f64; 3]]) -> bool {
        let reach = self.reach(points);
        self.window.move_to(self.field.blocks, reach)
    }

    /// A box around points, finest voxels of the submap frame.
    #[inline(always)]
    fn voxels_around(&self, points: &[[f64; 3]]) -> ([f64; 3], [f64; 3]) {
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        let add = |low: &mut [f64; 3], high: &mut [f64; 3], p: [f64; 3]| {
            for k in 0..3 {
                low[k] = if p[k] < low[k] { p[k] } else { low[k] };
                high[k] = if p[k] > high[k] { p[k] } else { high[k] };
            }
        };
        points.iter().for_each(|p| add(&mut low, &mut high, *p));
        let (mut first, mut last) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for corner in 0..8 {
            let p = std::array::from_fn(|k| if corner >> k & 1 == 0 { low[k] } else { high[k] });
            add(&mut first, &mut last, self.field.placement.to_submap(p).map(|c| c / self.voxel));
        }
        (first, last)
    }

    /// Samples at `points`, at most as many as there are lanes, that the window was moved to.
    #[inline(always)]
    fn sample<A: Answer>(&mut self, points: &[[f64; 3]], answers: &mut [A]) {
        // Unused lanes are at the origin, or at the edge of the window.
        let mut p = [[0.0; LANES]; 3];
        for (k, point) in points.iter().enumerate() {
            let place = self.field.placement.to_submap(*point);
            (p[0][k], p[1][k], p[2][k]) = (place[0] / self.voxel, place[1] / self.voxel, place[2] / self.voxel);
        }
        let (own, voxel) = self.own_voxels(&p);
        let (mut numbers, mut scales) = ([0; LANES], [0; LANES]);
        let mut is_any_known = false;
        for k in 0..points.len() {
            numbers[k] = self.window.number(self.field.field, self.voxel, own[k]);
            scales[k] = u32::from(self.window.scale(numbers[k]));
            is_any_known |= numbers[k] != 0;
        }
        if !is_any_known {
            return;
        }
        let stored = self.window.distances(&numbers, &voxel);
        let (corners, fractions) = self.corners(&p, &scales, &numbers);
        let at = |k: usize| -> ([f32; 8], [f32; 3]) { (std::array::from_fn(|i| corners[i][k]), std::array::from_fn(|a| fractions[a][k])) };
        let mut distances = stored;
        for (k, distance) in distances.iter_mut().enumerate() {
            let (corners, fractions) = at(k);
            let between = trilinear(corners, fractions).0;
            *distance = if between.is_nan() | distance.is_nan() { *distance } else { between };
        }
        for (k, answer) in answers.iter_mut().enumerate() {
            answer.take_nearer(distances[k], || {
                let (corners, fractions) = at(k);
                let (between, steps) = trilinear(corners, fractions);
                let edge = (f64::from(1u32 << scales[k]) * self.voxel) as f32;
                let gradient = if between.is_nan() { [0.0; 3] } else { steps.map(|step| step / edge) };
                self.field.placement.to_map(SurfaceDistance { distance: between, gradient }).gradient
            });
        }
    }

    /// Of the finest voxels that hold points, the indices of their blocks and of the voxels in them.
    #[inline(always)]
    fn own_voxels(&self, p: &[[f64; LANES]; 3]) -> ([u32; LANES], [u32; LANES]) {
        let (mut block, mut voxel) = ([0; LANES], [0; LANES]);
        for (axis, p) in p.iter().enumerate() {
            for k in 0..LANES {
                let at = self.window.inside(axis, p[k].floor());
                block[k] += self.window.block_part(axis, at);
                voxel[k] |= BlockWindow::voxel_part(axis, at);
            }
        }
        (block, voxel)
    }

    /// Distances in the eight voxels around each point, at the scale of its block, and where it is between them.
    #[inline(always)]
    fn corners(&mut self, p: &[[f64; LANES]; 3], scales: &[u32; LANES], numbers: &[u32; LANES]) -> ([[f32; LANES]; 8], [[f32; LANES]; 3]) {
        let mut fractions = [[0.0; LANES]; 3];
        let mut parts = Corners { block: [[[0; LANES]; 3]; 2], voxel: [[[0; LANES]; 3]; 2] };
        let mut is_between_blocks = [0; LANES];
        for axis in 0..3 {
            for k in 0..LANES {
                // 2^scale.
                let edge = f64::from_bits(u64::from(1023 + scales[k]) << 52);
                let q = p[axis][k] / edge - 0.5;
                let base = q.floor();
                fractions[axis][k] = (q - base) as f32;
                // The finest voxel at, or next above, the centre of each.
                let centre = base * edge + f64::from(1u32 << scales[k] >> 1);
                let [low, high] = [self.window.inside(axis, centre), self.window.inside(axis, centre + edge)];
                (parts.block[0][axis][k], parts.block[1][axis][k]) = (self.window.block_part(axis, low), self.window.block_part(axis, high));
                (parts.voxel[0][axis][k], parts.voxel[1][axis][k]) = (BlockWindow::voxel_part(axis, low), BlockWindow::voxel_part(axis, high));
                is_between_blocks[k] |= parts.block[0][axis][k] ^ parts.block[1][axis][k];
            }
        }
        let corner = |parts: &[[[u32; LANES]; 3]; 2], i: usize, k: usize| parts[i & 1][0][k] + parts[i >> 1 & 1][1][k] + parts[i >> 2][2][k];
        for k in (0..LANES).filter(|k| numbers[*k] != 0 && is_between_blocks[*k] != 0) {
            (0..8).for_each(|i| {
                self.window.number(self.field.field, self.voxel, corner(&parts.block, i, k));
            });
        }
        let mut corners = [[0.0; LANES]; 8];
        for (i, corners) in corners.iter_mut().enumerate() {
            let (mut block, mut voxel) = ([0; LANES], [0; LANES]);
            for k in 0..LANES {
                (block[k], voxel[k]) = (corner(&parts.block, i, k), corner(&parts.voxel, i, k));
            }
            *corners = self.window.distances(&self.window.numbers(&block), &voxel);
        }
        (corners, fractions)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::atlas::Atlas;
    use crate::geometry::{Pose, Rigid};
    use crate::integrate::{ReturnsView, TsdfIntegrator, TsdfSettings};
    use nalgebra::Vector3;

    /// Two submaps of a wavy floor, of which one is compact; nearer parts have finer voxels.
    fn floors() -> Atlas {
        let mut atlas = Atlas::new(0.1);
        for (k, turn) in [0.0, 0.4].into_iter().enumerate() {
            let t_map_submap = Pose::new(Vector3::new(3.0 * turn, 1.0, -0.1 * turn), Vector3::new(0.05, turn, 0.3));
            let points: Vec<[f32; 3]> = (0..300 * 300)
                .map(|i| {
                    let (x, y) = ((i % 300) as f32 * 0.06 - 9.0, (i / 300) as f32 * 0.06 - 9.0);
                    [x, y, 0.3 * (0.7 * x).sin() - 2.0]
                })
                .collect();
            let normals = points.iter().map(|p| Vector3::new(-0.21 * (0.7 * p[0]).cos(), 0.0, 1.0).normalize().into()).collect::<Vec<[f32; 3]>>();
            let returns = ReturnsView::of_points(&points, &normals, 0.06);
            let id = atlas.spawn(t_map_submap);
            let sensor = Rigid::from(&Pose::identity());
            TsdfIntegrator::new(TsdfSettings { voxel_size: 0.1, ..TsdfSettings::default() }).integrate(
                &mut atlas.submap_mut(id).unwrap().tsdf,
                &sensor,
                &returns,
            );
            if k == 0 {
                atlas.compact();
            }
        }
        atlas
    }

    #[test]
    fn many_points_at_once_are_as_one_by_one() {
        let atlas = floors();
        let query = DistanceQuery::new(&atlas);
        assert!(
            atlas.submaps().iter().all(|submap| submap.tsdf().blocks_by_scale().iter().filter(|blocks| **blocks > 0).count() > 1),
            "several scales"
        );
        // Places of a low-discrepancy sequence near both floors; some are no places at all.
        let fraction = |k: usize, step: f64| (k as f64 * step).fract();
        let mut points: Vec<[f64; 3]> = (0..3 * FEW)
            .map(|k| [20.0 * fraction(k, 0.754_877_666) - 10.0, 20.0 * fraction(k, 0.569_840_291) - 10.0, 8.0 * fraction(k, 0.362_343_1) - 5.0])
            .collect();
        points[7] = [f64::NAN, 0.0, 0.0];
        points[8] = [1e300, 0.0, 0.0];
        points[9] = [0.0, f64::NEG_INFINITY, 0.0];
        let one_by_one: Vec<_> = points.iter().map(|p| query.sample(*p)).collect();
        let with_gradient = one_by_one.iter().flatten().filter(|sample| sample.gradient != [0.0; 3]).count();
        let known = one_by_one.iter().flatten().count();
        assert!(with_gradient > 200 && known > with_gradient && known < points.len(), "{with_gradient} of {known}");
        assert!(query.sample_many(&points) == one_by_one);
        assert!(query.sample_many(&points[..FEW - 1]) == one_by_one[..FEW - 1]);
        let single = points.iter().map(|p| p.map(|c| c as f32)).collect::<Vec<_>>();
        let expected: Vec<_> = single.iter().map(|p| query.sample(p.map(f64::from))).collect();
        assert!(query.sample_many(&single) == expected);
        // Without gradients; NaN is none.
        let bits = |samples: &[Option<SurfaceDistance>]| samples.iter().map(|s| s.map(|s| s.distance.to_bits())).collect::<Vec<_>>();
        let alone = |distances: Vec<f32>| distances.iter().map(|d| (!d.is_nan()).then(|| d.to_bits())).collect::<Vec<_>>();
        assert!(alone(query.sample_distances(&points)) == bits(&one_by_one) && alone(query.sample_distances(&single)) == bits(&expected));
        assert!(alone(query.sample_distances(&points[..9])) == bits(&one_by_one[..9]));
        // More than one batch.
        let often: Vec<[f64; 3]> = points.iter().cycle().take((1 << 20) + points.len()).copied().collect();
        let found = query.sample_many(&often);
        assert!(found.chunks(points.len()).all(|part| part == &one_by_one[..part.len()]));
    }

    #[test]
    fn points_too_far_apart_for_a_window_are_sampled_one_by_one() {
        let atlas = floors();
        let query = DistanceQuery::new(&atlas);
        let fields: Vec<PlacedField<'_>> = query.parts.iter().filter_map(PlacedField::new).collect();
        // A field that seems to be everywhere, so that a window would have to be, too.
        let everywhere = BlockBox { low: [-100_000; 3], high: [100_000; 3] };
        let fields: Vec<PlacedField<'_>> = fields.into_iter().map(|field| PlacedField { blocks: everywhere, ..field }).collect();
        // Up and down through the floors, and far away.
        let near = (0..300).map(|k| [f64::from(k) * 0.06 - 9.0, f64::from(k) * 0.02 - 3.0, f64::from(k % 6) * 0.2 - 2.5]);
        let points: Vec<[f64; 3]> = near.chain([[4e4, -4e4, 0.0], [-4e4, 4e4, 9e3]]).collect();
        let mut window = BlockWindow::new();
        assert_eq!(Sampler { field: &fields[0], voxel: 0.1, window: &mut window }.reach(&points), Reach::TooMuch);
        let mut answers = vec![None; points.len()];
        dispatch(SampleTask { fields: &fields, voxel: query.voxel, points: &points, answers: &mut answers, window: &mut window });
        let one_by_one: Vec<_> = points.iter().map(|p| query.sample(*p)).collect();
        assert!(one_by_one.iter().flatten().count() > 20 && answers == one_by_one);
    }
}
