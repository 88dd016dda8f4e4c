//! A dense reference occupancy map: one resolution, every voxel compared with every ray of every scan.

use std::collections::HashMap;
use std::f64::consts::TAU;
use voxelastic::geometry::Rigid;
use voxelastic::integrate::OccupancySettings;
use voxelastic::sensor::BeamModel;

pub struct DenseOccupancy {
    settings: OccupancySettings,
    elevations: Vec<f64>,
    columns: usize,
    first_azimuth: f64,
    /// Log-odds by voxel coordinates; absent means unknown.
    pub voxels: HashMap<[i32; 3], f32>,
}

/// One scan as an image: range of each pixel, 0 without return.
struct Image {
    ranges: Vec<f64>,
}

impl DenseOccupancy {
    pub fn new(settings: OccupancySettings, model: &BeamModel) -> Self {
        Self {
            settings,
            elevations: model.elevations().iter().map(|&e| f64::from(e)).collect(),
            columns: model.columns(),
            first_azimuth: f64::from(model.azimuth(0.0, -0.5)),
            voxels: HashMap::new(),
        }
    }

    /// Fractional column of an azimuth; the first pixel covers 0 to 1.
    fn column(&self, azimuth: f64) -> f64 {
        (azimuth - self.first_azimuth).rem_euclid(TAU) * self.columns as f64 / TAU
    }

    /// Integrates a scan into all voxels of the box from `low` to `high`.
    pub fn integrate(&mut self, pose: &Rigid, points: &[[f32; 3]], low: [i32; 3], high: [i32; 3]) {
        let mut updates: HashMap<[i32; 3], f32> = HashMap::new();
        let image = self.image(points);
        for z in low[2]..=high[2] {
            for y in low[1]..=high[1] {
                for x in low[0]..=high[0] {
                    if self.is_free([x, y, z], pose, &image) {
                        updates.insert([x, y, z], self.settings.free);
                    }
                }
            }
        }
        for p in points {
            self.walk(*p, pose, &mut updates);
        }
        for (c, update) in updates {
            let value = self.voxels.entry(c).or_insert(0.0);
            *value = (*value + update).clamp(self.settings.min, self.settings.max);
        }
    }

    fn image(&self, points: &[[f32; 3]]) -> Image {
        let mut ranges = vec![0f64; self.elevations.len() * self.columns];
        for p in points {
            let p = p.map(f64::from);
            let range = p.iter().map(|c| c * c).sum::<f64>().sqrt();
            let row = self.row((p[2] / range).asin()).round() as usize;
            let column = self.column(p[1].atan2(p[0])) as usize % self.columns;
            let pixel = &mut ranges[row * self.columns + column];
            *pixel = if *pixel == 0.0 { range } else { pixel.min(range) };
        }
        Image { ranges }
    }

    fn row(&self, elevation: f64) -> f64 {
        let gap = self.elevations[0] - self.elevations[1];
        (self.elevations[0] - elevation) / gap
    }

    /// Whether all rays through the voxel and around it have their returns beyond it.
    fn is_free(&self, c: [i32; 3], pose: &Rigid, image: &Image) -> bool {
        let voxel = f64::from(self.settings.voxel_size);
        let in_lidar = |part: [f64; 3]| -> [f64; 3] {
            let offset: [f64; 3] = std::array::from_fn(|k| (f64::from(c[k]) + part[k]) * voxel - f64::from(pose.translation[k]));
            std::array::from_fn(|j| (0..3).map(|i| f64::from(pose.rotation[i][j]) * offset[i]).sum())
        };
        let p = in_lidar([0.5; 3]);
        let flat = p[0].hypot(p[1]);
        let (range, radius) = (flat.hypot(p[2]), 0.5 * 3f64.sqrt() * voxel);
        if radius > 0.5 * flat {
            return false;
        }
        let middle = self.column(p[1].atan2(p[0]));
        let half = self.columns as f64 / 2.0;
        let (mut rows, mut columns, mut farthest) = ((f64::MAX, f64::MIN), (f64::MAX, f64::MIN), 0f64);
        for corner in 0..8 {
            let q = in_lidar([0, 1, 2].map(|k| f64::from(corner >> k & 1)));
            let distance = q[0].hypot(q[1]).hypot(q[2]);
            let row = self.row((q[2] / distance).asin()) + 0.5;
            let column = middle + (self.column(q[1].atan2(q[0])) - middle + half).rem_euclid(2.0 * half) - half;
            rows = (rows.0.min(row), rows.1.max(row));
            columns = (columns.0.min(column), columns.1.max(column));
            farthest = farthest.max(distance);
        }
        let margin = 3.0 * f64::from(self.settings.sigma + self.settings.sigma_per_metre * range as f32).max(0.25 * voxel);
        for r in (rows.0 - 0.5).floor() as i64..=(rows.1 + 0.5).floor() as i64 {
            for k in (columns.0 - 0.5).floor() as i64..=(columns.1 + 0.5).floor() as i64 {
                if r < 0 || r >= self.elevations.len() as i64 {
                    return false;
                }
                let range_there = image.ranges[r as usize * self.columns + k.rem_euclid(self.columns as i64) as usize];
                if farthest + margin >= range_there {
                    return false;
                }
            }
        }
        true
    }

    /// Adds the evidence of one ray, the largest per voxel; the ray is cut at voxel faces.
    fn walk(&self, p: [f32; 3], pose: &Rigid, updates: &mut HashMap<[i32; 3], f32>) {
        let voxel = f64::from(self.settings.voxel_size);
        let world = pose.apply(p).map(|c| f64::from(c) / voxel);
        let ray = pose.rotate(p).map(f64::from);
        let range = ray.iter().map(|c| c * c).sum::<f64>().sqrt();
        let direction = ray.map(|c| c / range);
        let sigma = f64::from(self.settings.sigma + self.settings.sigma_per_metre * range as f32).max(0.25 * voxel) / voxel;
        let thickness = f64::from(self.settings.thickness_voxels);
        let (free, hit) = (f64::from(self.settings.free), f64::from(self.settings.hit));
        let (before, behind) = (-3.0 * sigma, thickness);
        let mut cuts = vec![before, behind];
        for k in 0..3 {
            let (a, b) = (world[k] + before * direction[k], world[k] + behind * direction[k]);
            cuts.extend((a.min(b).ceil() as i64..=a.max(b).floor() as i64).map(|face| (face as f64 - world[k]) / direction[k]));
        }
        cuts.retain(|t| (before..=behind).contains(t));
        cuts.sort_by(f64::total_cmp);
        for w in cuts.windows(2).filter(|w| w[1] > w[0]) {
            let c: [i32; 3] = std::array::from_fn(|k| (world[k] + 0.5 * (w[0] + w[1]) * direction[k]).floor() as i32);
            let d = (0..3).map(|k| direction[k] * (f64::from(c[k]) + 0.5 - world[k])).sum::<f64>().clamp(before, behind);
            let rise = free + (hit - free) * ((d + 3.0 * sigma) / (2.0 * sigma)).clamp(0.0, 1.0);
            let update = rise.min(hit * ((thickness - d) / (0.5 * thickness)).clamp(0.0, 1.0)) as f32;
            updates.entry(c).and_modify(|u| *u = u.max(update)).or_insert(update);
        }
    }
}
