//! Bridging: returns between two rows of beams that lie on one surface.
//!
//! Rows of a LiDAR are often several voxels apart where its columns are not: a wall at 10 m is seen as stripes, and a mesh of
//! it has holes. Where two returns, one above the other, agree on a plane, the surface between them is that plane; returns
//! are put on it a voxel apart. They are walked like measured ones, but only into the TSDF: free space is never bridged.

use super::scale::ScaleRule;
use super::transform::Returns;
use crate::sensor::{NO_POINT, PreparedScan};

/// When two returns count as one surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BridgeSettings {
    /// Most returns put between two measured ones; 0 for none.
    pub most: usize,
    /// Cosine of the largest angle between the normals.
    pub least_cosine: f32,
    /// Largest distance of either return from the other's plane, in finest voxels.
    pub offset_voxels: f32,
}

impl Default for BridgeSettings {
    fn default() -> Self {
        Self { most: 2, least_cosine: 0.94, offset_voxels: 0.5 }
    }
}

/// The returns of a scan, measured ones first, bridged ones behind. Keeps its memory from scan to scan.
#[derive(Clone, Debug, Default)]
pub struct Bridge {
    points: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    shades: Vec<u8>,
    origins: Vec<[f32; 3]>,
    smallest_angle: f32,
    /// Beam that each pixel of the image shows, or [`NO_POINT`].
    beam_of_pixel: Vec<u32>,
}

impl Bridge {
    /// Takes over the beams of `scan` and bridges them at the spacing of voxels of `voxel` metres at the scale of `rule`.
    pub fn span(&mut self, scan: &PreparedScan, shades: &[u8], voxel: f32, rule: &ScaleRule, settings: &BridgeSettings) {
        let beams = &scan.beams;
        self.points.clone_from(&beams.points);
        self.normals.clone_from(&beams.normals);
        self.shades.clear();
        self.shades.extend_from_slice(shades);
        self.origins.clone_from(&beams.origins);
        self.smallest_angle = beams.smallest_angle;
        if settings.most == 0 {
            return;
        }
        self.beam_of_pixel.clear();
        self.beam_of_pixel.resize(scan.image.ranges.len(), NO_POINT);
        for (beam, (&pixel, &source)) in beams.pixel.iter().zip(&beams.source).enumerate() {
            if scan.image.points[pixel as usize] == source {
                self.beam_of_pixel[pixel as usize] = beam as u32;
            }
        }
        let columns = scan.image.columns;
        for upper in 0..self.beam_of_pixel.len() - columns {
            let (a, b) = (self.beam_of_pixel[upper], self.beam_below(upper, columns));
            if a != NO_POINT && b != NO_POINT {
                let spacing = voxel * (1 << rule.fitting(beams.ranges[a as usize])) as f32;
                self.span_pair(a as usize, b as usize, spacing, voxel, settings);
            }
        }
    }

    /// The beam in the pixel below `upper`, or in the one beside that where a projected cloud left a gap.
    #[inline(always)]
    fn beam_below(&self, upper: usize, columns: usize) -> u32 {
        let row = upper - upper % columns + columns;
        let column = upper % columns;
        let beside = [column, (column + 1) % columns, (column + columns - 1) % columns];
        beside.into_iter().map(|c| self.beam_of_pixel[row + c]).find(|&beam| beam != NO_POINT).unwrap_or(NO_POINT)
    }

    /// Puts returns between the measured ones `a` and `b` if they lie on one surface.
    #[inline(always)]
    fn span_pair(&mut self, a: usize, b: usize, spacing: f32, voxel: f32, settings: &BridgeSettings) {
        let (p, q, m, n) = (self.points[a], self.points[b], self.normals[a], self.normals[b]);
        let step: [f32; 3] = std::array::from_fn(|k| q[k] - p[k]);
        let gap = dot(step, step);
        if gap <= spacing * spacing || dot(m, n) < settings.least_cosine {
            return;
        }
        let offset = settings.offset_voxels * voxel;
        if dot(step, m).abs() > offset || dot(step, n).abs() > offset {
            return;
        }
        let count = ((gap.sqrt() / spacing).ceil() as usize - 1).min(settings.most);
        for i in 1..=count {
            let t = i as f32 / (count + 1) as f32;
            let normal: [f32; 3] = std::array::from_fn(|k| m[k] + t * (n[k] - m[k]));
            let length = dot(normal, normal).sqrt();
            self.points.push(std::array::from_fn(|k| p[k] + t * step[k]));
            self.normals.push(normal.map(|c| c / length));
            if !self.shades.is_empty() {
                let shade = if t < 0.5 { self.shades[a] } else { self.shades[b] };
                self.shades.push(shade);
            }
            if !self.origins.is_empty() {
                self.origins.push(self.origins[a]);
            }
        }
    }

    /// Measured and bridged returns.
    pub fn returns(&self) -> Returns<'_> {
        Returns { points: &self.points, normals: &self.normals, shades: &self.shades, origins: &self.origins, smallest_angle: self.smallest_angle }
    }
}

#[inline(always)]
fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
