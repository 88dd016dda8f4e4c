//! Signed distance to surfaces between voxels, and its gradient.

use super::DistanceQuery;
use crate::field::tsdf::TsdfField;
use crate::geometry::Pose;
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, MAX_BLOCK_COORD, block_key, voxel_index};

/// The distance field at a point.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct SurfaceDistance {
    /// Signed distance to the nearest surface, metres, positive in front of it.
    pub distance: f32,
    /// Its gradient in the map frame, away from the surface towards free space, of about unit length; zero where the field is known on one
    /// side of the point only.
    pub gradient: [f32; 3],
}

/// Where a field lies in the map.
pub(super) struct Placement {
    /// Rows of the rotation from the map frame to the submap frame.
    rotation: [[f64; 3]; 3],
    translation: [f64; 3],
}

impl Placement {
    pub fn new(t_submap_map: &Pose) -> Self {
        let rotation = t_submap_map.rotation.to_rotation_matrix();
        let rows = std::array::from_fn(|i| std::array::from_fn(|j| rotation[(i, j)]));
        Self { rotation: rows, translation: t_submap_map.translation.vector.into() }
    }

    /// A point of the map frame in the submap frame.
    #[inline(always)]
    pub fn to_submap(&self, p: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|i| self.rotation[i][0] * p[0] + self.rotation[i][1] * p[1] + self.rotation[i][2] * p[2] + self.translation[i])
    }

    /// A sample of the submap frame in the map frame.
    #[inline(always)]
    pub fn to_map(&self, sample: SurfaceDistance) -> SurfaceDistance {
        let [x, y, z] = sample.gradient.map(f64::from);
        let gradient = std::array::from_fn(|j| (self.rotation[0][j] * x + self.rotation[1][j] * y + self.rotation[2][j] * z) as f32);
        SurfaceDistance { gradient, ..sample }
    }
}

impl DistanceQuery<'_> {
    /// The field at `p` (metres, map frame), interpolated between the eight voxels around it; of all submaps the value nearest to zero. Where
    /// some of the eight are not observed, it is the distance stored in the voxel at `p`, without a gradient. None if no submap has an
    /// observed voxel there. [`sample_many`](Self::sample_many) is faster for many points.
    pub fn sample(&self, p: [f64; 3]) -> Option<SurfaceDistance> {
        let samples = self.parts.iter().filter_map(|(field, t_submap_map)| {
            let placement = Placement::new(t_submap_map);
            let sample = interpolate(&mut StoredVoxels::new(field, self.voxel), self.voxel, placement.to_submap(p))?;
            Some(placement.to_map(sample))
        });
        samples.min_by(|a, b| a.distance.abs().total_cmp(&b.distance.abs()))
    }
}

/// The finest voxel at, or next above, the centre of corner `i` of the eight voxels of `scale` at `base` and next above it.
fn corner_centre(base: [i32; 3], scale: usize, i: usize) -> [i32; 3] {
    std::array::from_fn(|k| ((base[k] + (i >> k & 1) as i32) << scale) + (1 << scale >> 1))
}

/// Whether a point, in finest voxels of the submap frame, and its neighbours have coordinates that keys can hold.
fn is_addressable(p: [f64; 3]) -> bool {
    p.iter().all(|c| c.abs() < f64::from(MAX_BLOCK_COORD - 1) * BLOCK_EDGE as f64)
}

/// The field at `p`, metres in the submap frame, with finest voxels of `voxel` metres.
fn interpolate(source: &mut StoredVoxels<'_>, voxel: f64, p: [f64; 3]) -> Option<SurfaceDistance> {
    let p = p.map(|c| c / voxel);
    if !is_addressable(p) {
        return None;
    }
    let (stored, scale) = source.stored(p.map(|c| c.floor() as i32))?;
    let edge = f64::from(1 << scale);
    // Between the centres of voxels of the block's scale.
    let q = p.map(|c| c / edge - 0.5);
    let base = q.map(f64::floor);
    let [fx, fy, fz] = std::array::from_fn(|k| (q[k] - base[k]) as f32);
    let Some(corners) = source.corners(base.map(|c| c as i32), scale) else {
        return Some(SurfaceDistance { distance: stored, gradient: [0.0; 3] });
    };
    let (distance, steps) = trilinear(corners, [fx, fy, fz]);
    let metres = (edge * voxel) as f32;
    Some(SurfaceDistance { distance, gradient: steps.map(|step| step / metres) })
}

/// The value between eight corners, x fastest, and its change along each axis from one corner to the next. NaN if any of the corners is.
#[inline(always)]
pub(super) fn trilinear(corners: [f32; 8], [fx, fy, fz]: [f32; 3]) -> (f32, [f32; 3]) {
    // First along x, then y, then z.
    let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
    let steps: [f32; 4] = std::array::from_fn(|i| corners[2 * i + 1] - corners[2 * i]);
    let rows: [f32; 4] = std::array::from_fn(|i| corners[2 * i] + steps[i] * fx);
    let [low, high] = [mix(rows[0], rows[1], fy), mix(rows[2], rows[3], fy)];
    let changes = [mix(mix(steps[0], steps[1], fy), mix(steps[2], steps[3], fy), fz), mix(rows[1] - rows[0], rows[3] - rows[2], fz), high - low];
    (mix(low, high, fz), changes)
}

/// Voxels as they are stored.
struct StoredVoxels<'a> {
    field: &'a TsdfField,
    voxel: f64,
    /// The block that was looked up last: key and id.
    last: Option<(u64, u32)>,
}

impl<'a> StoredVoxels<'a> {
    fn new(field: &'a TsdfField, voxel: f64) -> Self {
        Self { field, voxel, last: None }
    }

    /// Distance in the voxel that holds finest voxel `c`, metres, and the scale of its block; none where it is not observed.
    fn stored(&mut self, c: [i32; 3]) -> Option<(f32, usize)> {
        let key = block_key(c.map(|v| v >> BLOCK_SHIFT));
        let id = match self.last {
            Some((last, id)) if last == key => id,
            _ => self.field.find(key)?,
        };
        self.last = Some((key, id));
        let block = self.field.block(id);
        let scale = usize::from(block.scale);
        let voxel = self.field.voxel(block, voxel_index(c.map(|v| (v as usize & (BLOCK_EDGE - 1)) >> scale), scale));
        voxel.is_observed().then(|| (voxel.distance_in_voxels() * (self.voxel * f64::from(1 << scale)) as f32, scale))
    }

    /// Distances, metres, in the voxels with edges of 2^scale finest voxels at `base` and next above it along each axis, x fastest; none unless all are
    /// observed. Where another scale is stored, it is the distance in the voxel around the centre.
    fn corners(&mut self, base: [i32; 3], scale: usize) -> Option<[f32; 8]> {
        let mut corners = [0.0; 8];
        for (i, corner) in corners.iter_mut().enumerate() {
            *corner = self.stored(corner_centre(base, scale, i))?.0;
        }
        Some(corners)
    }
}

#[cfg(test)]
mod tests {
    use crate::atlas::Atlas;
    use crate::geometry::{Pose, Rigid};
    use crate::integrate::{ReturnsView, TsdfIntegrator, TsdfSettings};
    use nalgebra::Vector3;

    /// A submap at `t_map_submap` of the plane through its origin with normal (0.6, 0, 0.8).
    fn plane(t_map_submap: Pose) -> Atlas {
        let points: Vec<[f32; 3]> = (0..200 * 200)
            .map(|i| {
                let (u, v) = ((i % 200) as f32 * 0.05 - 5.0, (i / 200) as f32 * 0.05 - 5.0);
                [0.8 * u, v, -0.6 * u]
            })
            .collect();
        let normals = vec![[0.6, 0.0, 0.8]; points.len()];
        // The sensor is above the plane.
        let sensor = Rigid { rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], translation: [0.0, 0.0, 8.0] };
        let seen: Vec<[f32; 3]> = points.iter().map(|p| [p[0], p[1], p[2] - 8.0]).collect();
        let returns = ReturnsView::of_points(&seen, &normals, 0.003);
        let mut atlas = Atlas::new(0.1);
        let id = atlas.spawn(t_map_submap);
        let settings = TsdfSettings { voxel_size: 0.1, ..TsdfSettings::default() };
        TsdfIntegrator::new(settings).integrate(&mut atlas.submap_mut(id).unwrap().tsdf, &sensor, &returns);
        atlas
    }

    #[test]
    fn a_plane_has_its_distance_and_its_normal_in_any_frame() {
        let t_map_submap = Pose::new(Vector3::new(20.0, -7.0, 3.0), Vector3::new(0.2, -0.1, 0.9));
        let atlas = plane(t_map_submap);
        let query = super::DistanceQuery::new(&atlas);
        let normal = Vector3::new(0.6, 0.0, 0.8);
        let (mut errors, mut turns) = (Vec::new(), Vec::new());
        // Where all eight voxels are within the truncation band.
        for i in 0..2000 {
            let (u, v, d) = ((i % 37) as f64 * 0.1 - 1.8, (i % 53) as f64 * 0.07 - 1.8, (i % 6) as f64 * 0.01 - 0.02);
            let p = t_map_submap * nalgebra::Point3::from(Vector3::new(0.8 * u, v, -0.6 * u) + normal * d);
            let sample = query.sample(p.coords.into()).unwrap();
            if sample.gradient == [0.0; 3] {
                continue;
            }
            let expected = t_map_submap.rotation * normal;
            errors.push((f64::from(sample.distance) - d).abs());
            turns.push((Vector3::from(sample.gradient.map(f64::from)) - expected).norm());
        }
        assert!(errors.len() > 1500, "{} of 2000", errors.len());
        // Some of the eight voxels are at the end of the band behind the plane, where stored distances are limited.
        let mean_and_worst = |v: &[f64]| [v.iter().sum::<f64>() / v.len() as f64, v.iter().copied().fold(0.0, f64::max)];
        let ([error, worst_error], [turn, worst_turn]) = (mean_and_worst(&errors), mean_and_worst(&turns));
        assert!(error < 1e-3 && worst_error < 0.012, "{error} m, at worst {worst_error} m");
        assert!(turn < 0.03 && worst_turn < 0.25, "{turn}, at worst {worst_turn}");
        assert_eq!(query.sample([20.0, -7.0, 40.0]), None);
        assert_eq!(query.sample([f64::NAN, 0.0, 0.0]), None);
        assert_eq!(query.sample([1e300, 0.0, 0.0]), None);
    }
}
