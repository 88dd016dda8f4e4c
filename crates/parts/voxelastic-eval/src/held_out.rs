//! Evaluation by held-out scans: distances of their points to a mesh that was made without them.
//!
//! Needs no survey: hold out every tenth scan of a sequence with accurate poses, map the others, and measure the held-out points.

use crate::error::Result;
use crate::mesh::MeshView;
use crate::mesh_distance::MeshIndex;
use crate::stats::DistanceStats;
use serde::Serialize;
use voxelastic::geometry::Rigid;
use voxelastic::{Cloud, Pose};

/// Settings of [`HeldOut`].
#[derive(Clone, Copy, Debug)]
pub struct HeldOutSettings {
    /// Points further than this from the sensor are left out, metres. Default 20.
    pub max_range: f32,
    /// Points nearer than this are left out (the robot, the person carrying the sensor), metres. Default 0.5.
    pub min_range: f32,
    /// Distances beyond this are misses, metres; default none.
    pub cut_off: f32,
}

impl Default for HeldOutSettings {
    fn default() -> Self {
        Self { max_range: 20.0, min_range: 0.5, cut_off: f32::INFINITY }
    }
}

/// Accumulates distances scan by scan, so that scans need not be in memory at once.
pub struct HeldOut {
    index: MeshIndex,
    settings: HeldOutSettings,
    distances: Vec<f32>,
    scans: Vec<HeldOutScan>,
}

/// Statistics of one scan in a [`HeldOutReport`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HeldOutScan {
    /// Points measured.
    pub points: usize,
    /// Half of them are at most this far from the mesh, metres.
    pub median: Option<f64>,
    /// 90 % of them are at most this far from the mesh, metres.
    pub p90: Option<f64>,
}

/// Result of [`HeldOut`], with stable JSON keys.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct HeldOutReport {
    /// Range up to which points were measured, metres.
    pub max_range_m: f32,
    /// Distances of all points to the mesh.
    pub distances: DistanceStats,
    /// Statistics per scan: an outlier has a bad pose.
    pub scans: Vec<HeldOutScan>,
}

impl HeldOut {
    /// Starts an evaluation of a mesh in the map frame.
    ///
    /// # Errors
    /// [`EvalError::Empty`](crate::EvalError::Empty) when the mesh has no triangles.
    pub fn new(mesh: &MeshView<'_>, settings: HeldOutSettings) -> Result<Self> {
        Ok(Self { index: MeshIndex::new(mesh)?, settings, distances: Vec::new(), scans: Vec::new() })
    }

    /// Measures one scan, given in the lidar frame.
    pub fn add(&mut self, cloud: &Cloud, t_map_lidar: &Pose) {
        let rigid = Rigid::from(t_map_lidar);
        let (near, far) = (self.settings.min_range.powi(2), self.settings.max_range.powi(2));
        let in_range = |p: &&[f32; 3]| Cloud::is_return(p) && (near..=far).contains(&p.iter().map(|c| c * c).sum::<f32>());
        let points: Vec<[f32; 3]> = cloud.points.iter().filter(in_range).map(|p| rigid.apply(*p)).collect();
        let distances = self.index.distances(&points, self.settings.cut_off);
        let stats = DistanceStats::new(&distances);
        self.scans.push(HeldOutScan { points: stats.count, median: stats.median, p90: stats.p90 });
        self.distances.extend(distances);
    }

    /// The result over all scans so far.
    pub fn report(&self) -> HeldOutReport {
        HeldOutReport { max_range_m: self.settings.max_range, distances: DistanceStats::new(&self.distances), scans: self.scans.clone() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion};

    #[test]
    fn points_in_range_are_measured_in_the_map_frame() {
        let corners = [[-50.0, -50.0, -1.0], [50.0, -50.0, -1.0], [50.0, 50.0, -1.0], [-50.0, 50.0, -1.0]];
        let mesh = MeshView::new(&corners, &[[0, 1, 2], [0, 2, 3]]).unwrap();
        let mut held_out = HeldOut::new(&mesh, HeldOutSettings::default()).unwrap();
        let pose = Pose::from_parts(Translation3::new(3.0, 4.0, 1.0), UnitQuaternion::from_euler_angles(0.0, 0.0, 1.0));
        // 2 m below the sensor (on the floor), 1.9 m below, too far, too near, no return, NaN.
        let points = vec![[1.0, 1.0, -2.0], [-2.0, 5.0, -1.9], [30.0, 0.0, -2.0], [0.1, 0.0, 0.1], [0.0; 3], [f32::NAN; 3]];
        held_out.add(&Cloud::from_points(points), &pose);
        let report = held_out.report();
        assert_eq!((report.distances.count, report.scans[0].points), (2, 2));
        assert!((report.distances.max.unwrap() - 0.1).abs() < 1e-5 && (report.distances.median.unwrap() - 0.05).abs() < 1e-5);
    }
}
