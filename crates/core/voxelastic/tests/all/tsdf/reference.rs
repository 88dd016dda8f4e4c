//! A dense reference TSDF: one resolution, a hash map of voxels, rays cut at every voxel face.

use std::collections::HashMap;
use voxelastic::field::tsdf::WEIGHT_ONE;
use voxelastic::geometry::Rigid;
use voxelastic::integrate::TsdfSettings;

/// Least sine of the angle between a ray and its plane.
const LEAST_SLOPE: f64 = 0.4;

pub struct DenseTsdf {
    settings: TsdfSettings,
    /// Distance in voxels and weight in the field's unit, by voxel coordinates.
    pub voxels: HashMap<[i32; 3], (f32, f32)>,
}

impl DenseTsdf {
    pub fn new(settings: TsdfSettings) -> Self {
        Self { settings, voxels: HashMap::new() }
    }

    pub fn integrate(&mut self, pose: &Rigid, points: &[[f32; 3]], normals: &[[f32; 3]]) {
        let voxel = f64::from(self.settings.voxel_size);
        let [along, front, behind] =
            [self.settings.truncation_voxels, self.settings.truncation_front + 0.5, self.settings.truncation_behind].map(f64::from);
        for (p, n) in points.iter().zip(normals) {
            let range = p.iter().map(|c| f64::from(*c).powi(2)).sum::<f64>().sqrt();
            let rotate =
                |v: [f32; 3]| -> [f64; 3] { std::array::from_fn(|i| (0..3).map(|k| f64::from(pose.rotation[i][k]) * f64::from(v[k])).sum()) };
            let ray = rotate(*p);
            let point: [f64; 3] = std::array::from_fn(|k| (ray[k] + f64::from(pose.translation[k])) / voxel);
            let mut direction = ray.map(|c| c / range);
            let normal = if *n == [0.0; 3] { direction.map(|c| -c) } else { rotate(*n) };
            let slope = -(0..3).map(|k| direction[k] * normal[k]).sum::<f64>();
            if slope < LEAST_SLOPE {
                // The component along the plane keeps its direction; its length makes a unit vector.
                let along: [f64; 3] = std::array::from_fn(|k| direction[k] + slope * normal[k]);
                let length = along.iter().map(|c| c * c).sum::<f64>().sqrt();
                direction = std::array::from_fn(|k| along[k] / length * (1.0 - LEAST_SLOPE * LEAST_SLOPE).sqrt() - LEAST_SLOPE * normal[k]);
            }
            let [before, beyond] = [front, behind].map(|off| (off / slope.max(LEAST_SLOPE)).min(along));
            for c in voxels_on_line(point, direction, [-before, beyond]) {
                let distance: f64 = (0..3).map(|k| normal[k] * (f64::from(c[k]) + 0.5 - point[k])).sum();
                self.observe(c, distance as f32, [along as f32, behind as f32]);
            }
        }
    }

    fn observe(&mut self, c: [i32; 3], distance: f32, [before, behind]: [f32; 2]) {
        let weight = f32::from(WEIGHT_ONE) * ((behind + distance) / (behind - 1.0).max(0.5)).min(1.0);
        if distance >= before || distance <= -behind || weight < 1.0 {
            return;
        }
        if distance >= self.settings.truncation_front && !self.voxels.contains_key(&c) {
            return;
        }
        let (mean, sum) = self.voxels.entry(c).or_default();
        *mean += (distance - *mean) * weight / (*sum + weight);
        // Weights are whole units in the field, so they are here.
        *sum = (*sum + weight).round_ties_even().min(self.settings.max_weight * f32::from(WEIGHT_ONE));
    }
}

/// Voxels that the line through `point` passes between two parameters: cut at every voxel face, the voxels of the middle of each interval.
fn voxels_on_line(point: [f64; 3], direction: [f64; 3], [from, to]: [f64; 2]) -> Vec<[i32; 3]> {
    let mut cuts = vec![from, to];
    for k in 0..3 {
        let (a, b) = (point[k] + from * direction[k], point[k] + to * direction[k]);
        for face in a.min(b).ceil() as i64..=a.max(b).floor() as i64 {
            cuts.push((face as f64 - point[k]) / direction[k]);
        }
    }
    cuts.retain(|t| (from..=to).contains(t));
    cuts.sort_by(f64::total_cmp);
    cuts.windows(2).filter(|w| w[1] > w[0]).map(|w| std::array::from_fn(|k| (point[k] + 0.5 * (w[0] + w[1]) * direction[k]).floor() as i32)).collect()
}
