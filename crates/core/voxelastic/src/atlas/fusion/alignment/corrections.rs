//! Where corrections of poses say that the content of a field is now.

use crate::atlas::{Submap, SubmapScan};
use crate::geometry::Pose;
use nalgebra::{Point3, Vector3};

/// At this distance from a sensor, metres, its scan counts half as much as right there: farther away, the number of rays falls with the square of the distance.
const NEAR: f64 = 5.0;

/// How the scans of a submap moved, in the map frame, since they were integrated.
#[derive(Clone, Debug, Default)]
pub(crate) struct Corrections {
    /// Where each scan was integrated, metres, and how it moved.
    scans: Vec<(Point3<f64>, Pose)>,
    voxel_size: f64,
}

impl Corrections {
    /// Those of a submap that lies at `t_map_submap`; none if no correction moved its scans relative to each other.
    pub fn new(submap: &Submap, t_map_submap: &Pose) -> Self {
        let moved = |(n, scan): (usize, &SubmapScan)| {
            let t_submap_lidar = submap.corrected.get(n).unwrap_or(&scan.t_submap_lidar);
            let integrated = t_map_submap * scan.t_submap_lidar;
            (integrated.translation.vector.into(), t_map_submap * t_submap_lidar * integrated.inverse())
        };
        let scans = if submap.corrected.is_empty() { Vec::new() } else { submap.scans.iter().enumerate().map(moved).collect() };
        Self { scans, voxel_size: f64::from(submap.voxel_size) }
    }

    /// Whether nothing was corrected.
    pub fn is_empty(&self) -> bool {
        self.scans.is_empty()
    }

    /// How much the surface at a point moved, both in finest voxels: the mean of what the scans say, those nearby first.
    pub fn at(&self, point: [f32; 3]) -> [f32; 3] {
        (self.at_point(&Point3::from(point.map(|c| f64::from(c) * self.voxel_size))) / self.voxel_size).map(|c| c as f32).into()
    }

    /// The same in metres.
    pub fn at_point(&self, point: &Point3<f64>) -> Vector3<f64> {
        let (mut sum, mut weights) = (Vector3::zeros(), 0.0);
        for (from, change) in &self.scans {
            let weight = 1.0 / ((point - from).norm_squared() + NEAR * NEAR);
            sum += weight * (change * point - point);
            weights += weight;
        }
        if weights > 0.0 { sum / weights } else { Vector3::zeros() }
    }
}
