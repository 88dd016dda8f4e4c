//! Distances and gradients at many points: sorted by where they are, so that a block is looked up and decoded once for all points near it.

use super::DistanceQuery;
use super::point_order::{Cells, FEW};
use super::surface_distance::{Placement, SurfaceDistance, VoxelSource, corner_centre, interpolate};
use crate::field::tsdf::{TsdfField, VoxelBuffer};
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, block_coords, block_key, voxel_index, voxels_at};
use crate::simd::{Kernel, dispatch};
use rayon::prelude::*;

/// Decoded blocks that a thread keeps: a cube of four along each axis.
const CACHED: usize = 64;

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
        if points.len() < FEW {
            return points.par_iter().with_min_len(64).map(|p| self.sample(p.map(Into::into))).collect();
        }
        let block = BLOCK_EDGE as f64 * self.voxel;
        let mut cells = Cells::new(block);
        for (field, t_submap_map) in &self.parts {
            let (corner, edge) = (block_coords(field.tree().root_key()), 1 << field.tree().root_level());
            let [low, high] = [corner, corner.map(|c| c + edge)].map(|corner| corner.map(|c| f64::from(c) * block));
            cells.cover(low, high, &t_submap_map.inverse());
        }
        let fields: Vec<_> = self.parts.iter().map(|(field, t_submap_map)| (*field, Placement::new(t_submap_map))).collect();
        cells.answer(points, None, |points, nearest| dispatch(SampleTask { fields: &fields, voxel: self.voxel, points, nearest }))
    }
}

/// Points near each other, to look up in all fields.
struct SampleTask<'a> {
    fields: &'a [(&'a TsdfField, Placement)],
    voxel: f64,
    points: &'a [[f64; 3]],
    nearest: &'a mut [Option<SurfaceDistance>],
}

impl Kernel for SampleTask<'_> {
    #[inline(always)]
    fn run(self) {
        for (field, placement) in self.fields {
            let mut blocks = DecodedBlocks::new(field, self.voxel);
            for (nearest, p) in self.nearest.iter_mut().zip(self.points) {
                let Some(sample) = interpolate(&mut blocks, self.voxel, placement.to_submap(*p)) else { continue };
                // The first of equals stays.
                if nearest.is_none_or(|old| sample.distance.abs() < old.distance.abs()) {
                    *nearest = Some(placement.to_map(sample));
                }
            }
        }
    }
}

/// The blocks of a field, decoded when they are needed.
struct DecodedBlocks<'a> {
    field: &'a TsdfField,
    voxel: f64,
    blocks: Vec<DecodedBlock>,
    /// Coordinates of the block that was used last, and where it is.
    at: [i32; 3],
    place: usize,
}

/// A block's distances at its current scale, metres; NaN where it is not observed.
struct DecodedBlock {
    key: u64,
    /// None if there is no such block.
    scale: Option<usize>,
    distances: [f32; voxels_at(0)],
}

impl<'a> DecodedBlocks<'a> {
    fn new(field: &'a TsdfField, voxel: f64) -> Self {
        Self { field, voxel, blocks: Vec::new(), at: [i32::MAX; 3], place: 0 }
    }

    /// Makes the block at `at` the current one.
    fn enter(&mut self, at: [i32; 3]) {
        let key = block_key(at);
        if self.blocks.is_empty() {
            self.blocks.resize_with(CACHED, || DecodedBlock { key: u64::MAX, scale: None, distances: [f32::NAN; voxels_at(0)] });
        }
        (self.at, self.place) = (at, key as usize % CACHED);
        let decoded = &mut self.blocks[self.place];
        if decoded.key == key {
            return;
        }
        decoded.key = key;
        decoded.scale = None;
        let Some(id) = self.field.find(key) else { return };
        let block = self.field.block(id);
        let scale = usize::from(block.scale);
        decoded.scale = Some(scale);
        let edge = (self.voxel * f64::from(1 << scale)) as f32;
        let mut voxels: VoxelBuffer = [Default::default(); voxels_at(0)];
        let voxels = &mut voxels[..voxels_at(scale)];
        self.field.copy(block, block.current(), voxels);
        for (distance, voxel) in decoded.distances.iter_mut().zip(voxels) {
            *distance = if voxel.is_observed() { voxel.distance_in_voxels() * edge } else { f32::NAN };
        }
    }
}

impl VoxelSource for DecodedBlocks<'_> {
    #[inline(always)]
    fn stored(&mut self, c: [i32; 3]) -> Option<(f32, usize)> {
        let at = c.map(|v| v >> BLOCK_SHIFT);
        if at != self.at {
            self.enter(at);
        }
        let DecodedBlock { scale, distances, .. } = &self.blocks[self.place];
        let scale = (*scale)?;
        let distance = distances[voxel_index(c.map(|v| (v as usize & (BLOCK_EDGE - 1)) >> scale), scale)];
        (!distance.is_nan()).then_some((distance, scale))
    }

    #[inline(always)]
    fn corners(&mut self, base: [i32; 3], scale: usize) -> Option<[f32; 8]> {
        let shift = BLOCK_SHIFT as usize - scale;
        let last = (1 << shift) - 1;
        let local = base.map(|c| c & last);
        if base.map(|c| c >> shift) != self.at || local.contains(&last) {
            return self.corners_of_several(base, scale);
        }
        // All eight are in the current block.
        let first = voxel_index(local.map(|c| c as usize), scale);
        let distances = &self.blocks[self.place].distances;
        let corners: [f32; 8] = std::array::from_fn(|i| distances[first + (i & 1) + ((i >> 1 & 1) << shift) + ((i >> 2) << (2 * shift))]);
        (!corners.iter().any(|d| d.is_nan())).then_some(corners)
    }
}

impl DecodedBlocks<'_> {
    /// Corners in several blocks.
    fn corners_of_several(&mut self, base: [i32; 3], scale: usize) -> Option<[f32; 8]> {
        let mut corners = [0.0; 8];
        for (i, corner) in corners.iter_mut().enumerate() {
            *corner = self.stored(corner_centre(base, scale, i))?.0;
        }
        Some(corners)
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
            let returns = ReturnsView { points: &points, normals: &normals, intensities: &[], origins: &[], smallest_angle: 0.06 };
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
        // More than one batch.
        let often: Vec<[f64; 3]> = points.iter().cycle().take((1 << 20) + points.len()).copied().collect();
        let found = query.sample_many(&often);
        assert!(found.chunks(points.len()).all(|part| part == &one_by_one[..part.len()]));
    }
}
