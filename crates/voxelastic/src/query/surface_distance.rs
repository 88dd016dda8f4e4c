//! Signed distance to surfaces between voxels, and its gradient.

use super::DistanceQuery;
use super::shape::moved;
use crate::field::tsdf::TsdfField;
use crate::octree::{BLOCK_EDGE, BLOCK_SHIFT, MAX_BLOCK_COORD, block_key, voxel_index};
use nalgebra::Vector3;

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

impl DistanceQuery<'_> {
    /// The field at `p` (metres, map frame), interpolated between the eight voxels around it; of all submaps the value nearest to zero. Where
    /// some of the eight are not observed, it is the distance stored in the voxel at `p`, without a gradient. None if no submap has an
    /// observed voxel there.
    pub fn sample(&self, p: [f64; 3]) -> Option<SurfaceDistance> {
        let samples = self.parts.iter().filter_map(|(field, t_submap_map)| {
            let sample = Interpolation::new(field, self.voxel).sample(moved(t_submap_map, p))?;
            let gradient = t_submap_map.rotation.inverse_transform_vector(&Vector3::from(sample.gradient.map(f64::from)));
            Some(SurfaceDistance { gradient: [gradient.x as f32, gradient.y as f32, gradient.z as f32], ..sample })
        });
        samples.min_by(|a, b| a.distance.abs().total_cmp(&b.distance.abs()))
    }
}

/// Interpolates in one field, submap frame.
struct Interpolation<'a> {
    field: &'a TsdfField,
    voxel: f64,
    /// The block that was looked up last: key and id.
    last: Option<(u64, u32)>,
}

impl<'a> Interpolation<'a> {
    fn new(field: &'a TsdfField, voxel: f64) -> Self {
        Self { field, voxel, last: None }
    }

    fn sample(mut self, p: [f64; 3]) -> Option<SurfaceDistance> {
        let p = p.map(|c| c / self.voxel);
        if !p.iter().all(|c| c.abs() < f64::from(MAX_BLOCK_COORD - 1) * BLOCK_EDGE as f64) {
            return None;
        }
        let (stored, scale) = self.stored(p.map(|c| c.floor() as i32))?;
        let edge = f64::from(1 << scale);
        // Between the centres of voxels of the block's scale.
        let q = p.map(|c| c / edge - 0.5);
        let base = q.map(f64::floor);
        let f: [f32; 3] = std::array::from_fn(|k| (q[k] - base[k]) as f32);
        let mut corners = [0.0; 8];
        for (i, corner) in corners.iter_mut().enumerate() {
            let centre = std::array::from_fn(|k| ((base[k] + (i >> k & 1) as f64 + 0.5) * edge).floor() as i32);
            let Some((distance, _)) = self.stored(centre) else {
                return Some(SurfaceDistance { distance: stored, gradient: [0.0; 3] });
            };
            *corner = distance;
        }
        let along = |k: usize, at: usize| {
            // The weight of corner `at` in the other two axes.
            (0..3).filter(|&j| j != k).map(|j| if at >> j & 1 == 1 { f[j] } else { 1.0 - f[j] }).product::<f32>()
        };
        let difference = |k: usize| (0..8).map(|i| if i >> k & 1 == 1 { corners[i] } else { -corners[i] } * along(k, i)).sum::<f32>();
        let weight = |i: usize| (0..3).map(|k| if i >> k & 1 == 1 { f[k] } else { 1.0 - f[k] }).product::<f32>();
        let metres = (edge * self.voxel) as f32;
        let distance = (0..8).map(|i| corners[i] * weight(i)).sum();
        Some(SurfaceDistance { distance, gradient: std::array::from_fn(|k| difference(k) / metres) })
    }

    /// Distance in the voxel that holds finest voxel `c`, metres, and the scale of its block.
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
        let returns = ReturnsView { points: &seen, normals: &normals, intensities: &[], origins: &[], smallest_angle: 0.003 };
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
