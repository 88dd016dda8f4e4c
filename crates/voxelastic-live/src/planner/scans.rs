//! Returns near the robot of scans that the planner has not had yet.

use std::collections::VecDeque;
use voxelastic::Cloud;
use voxelastic::event::{NodeId, Scan};

/// Returns within this distance are kept, metres: paths are checked against what is nearer.
const NEAR: f32 = 7.0;
/// Scans that wait: the newest.
const MOST: usize = 16;
/// Share of the returns below the lowest elevation that counts, and above the highest.
const OUTLIERS: f64 = 0.01;

/// A scan near the robot.
#[derive(Clone, Debug)]
pub struct NearScan {
    /// Its node.
    pub node: NodeId,
    /// Returns, lidar frame at the time stamp.
    pub cloud: Cloud,
}

/// Scans that wait for the planner.
#[derive(Debug, Default)]
pub struct NearScans {
    waiting: VecDeque<NearScan>,
    elevations: Option<[f64; 2]>,
}

impl NearScans {
    /// Keeps what is near of a scan, farther than `min_range` metres: what is nearer is the robot itself.
    pub fn add(&mut self, scan: &Scan, min_range: f32) {
        let cloud = &scan.cloud;
        if self.elevations.is_none() {
            self.elevations = elevations(cloud);
        }
        let squared = |p: &[f32; 3]| p.iter().map(|c| c * c).sum::<f32>();
        let is_near = |p: &[f32; 3]| Cloud::is_return(p) && (min_range * min_range..NEAR * NEAR).contains(&squared(p));
        let kept: Vec<usize> = (0..cloud.len()).filter(|k| is_near(&cloud.points[*k])).collect();
        let time = cloud.time.as_ref().filter(|time| time.len() == cloud.len()).map(|time| kept.iter().map(|k| time[*k]).collect());
        let near = Cloud { time, motion: cloud.motion.clone(), ..Cloud::from_points(kept.iter().map(|k| cloud.points[*k]).collect()) };
        let cloud = near.undistorted().unwrap_or(near);
        self.waiting.push_back(NearScan { node: scan.node, cloud });
        if self.waiting.len() > MOST {
            self.waiting.pop_front();
        }
    }

    /// Those that wait.
    pub fn take(&mut self) -> Vec<NearScan> {
        self.waiting.drain(..).collect()
    }

    /// Lowest and highest elevation of the first scan's returns, but for a few, radians.
    pub fn elevations(&self) -> Option<[f64; 2]> {
        self.elevations
    }
}

fn elevations(cloud: &Cloud) -> Option<[f64; 2]> {
    let returns = cloud.points.iter().filter(|p| Cloud::is_return(p));
    let mut all: Vec<f32> = returns.map(|[x, y, z]| z.atan2(x.hypot(*y))).collect();
    all.sort_unstable_by(f32::total_cmp);
    let at = |share: f64| all.get((share * all.len().saturating_sub(1) as f64) as usize).map(|e| f64::from(*e));
    Some([at(OUTLIERS)?, at(1.0 - OUTLIERS)?])
}

#[cfg(test)]
mod tests {
    use super::*;
    use voxelastic::Pose;

    fn scan(node: NodeId, points: Vec<[f32; 3]>) -> Scan {
        Scan { node, time: 0.0, t_map_lidar: Pose::identity(), cloud: Cloud::from_points(points) }
    }

    #[test]
    fn what_is_near_and_not_the_robot_is_kept_of_the_newest_scans() {
        let mut scans = NearScans::default();
        let points = vec![[0.2, 0.1, 0.0], [3.0, 0.0, -3.0], [20.0, 0.0, 2.0], [0.0; 3], [f32::NAN; 3]];
        (0..40).for_each(|node| scans.add(&scan(node, points.clone()), 0.5));
        let taken = scans.take();
        assert_eq!((taken.len(), taken[0].node, taken[15].node), (MOST, 24, 39));
        assert!(taken.iter().all(|scan| scan.cloud.points == [[3.0, 0.0, -3.0]]) && scans.take().is_empty());
        let [low, high] = scans.elevations().unwrap();
        assert!((low + std::f64::consts::FRAC_PI_4).abs() < 1e-6 && (0.0..0.1).contains(&high), "{low} {high}");
    }
}
