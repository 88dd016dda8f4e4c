//! Returns near the robot: of the last scan, and of those that the planner has not had yet.

use std::collections::{HashSet, VecDeque};
use std::ops::Range;
use voxelastic::Cloud;
use voxelastic::event::{NodeId, Scan};

/// The planner checks paths against returns within this distance, metres.
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
    /// Its time stamp, seconds.
    pub time: f64,
    /// Returns, lidar frame at the time stamp.
    pub cloud: Cloud,
}

impl NearScan {
    /// What is within `range` metres of a scan: what is nearer is the robot itself.
    pub fn of(scan: &Scan, range: Range<f32>) -> Self {
        let cloud = &scan.cloud;
        let squares = range.start * range.start..range.end * range.end;
        let is_near = |p: &[f32; 3]| Cloud::is_return(p) && squares.contains(&p.iter().map(|c| c * c).sum::<f32>());
        let kept: Vec<usize> = (0..cloud.len()).filter(|k| is_near(&cloud.points[*k])).collect();
        let time = cloud.time.as_ref().filter(|time| time.len() == cloud.len()).map(|time| kept.iter().map(|k| time[*k]).collect());
        let near = Cloud { time, motion: cloud.motion.clone(), ..Cloud::from_points(kept.iter().map(|k| cloud.points[*k]).collect()) };
        let cloud = near.undistorted().unwrap_or(near);
        Self { node: scan.node, time: scan.time, cloud }
    }
}

/// Where a sensor looks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beams {
    /// Lowest and highest elevation of the returns, but for a few, radians.
    pub elevations: [f64; 2],
    /// Angle between neighbours, radians: between rings; without rings that of as many returns, evenly spread.
    pub spacing: f64,
}

/// Scans that wait for the planner.
#[derive(Debug, Default)]
pub struct NearScans {
    waiting: VecDeque<NearScan>,
    beams: Option<Beams>,
}

impl NearScans {
    /// Keeps what is near of a scan, farther than `min_range` metres.
    pub fn add(&mut self, scan: &Scan, min_range: f32) {
        if self.beams.is_none() {
            self.beams = beams(&scan.cloud);
        }
        self.waiting.push_back(NearScan::of(scan, min_range..NEAR));
        if self.waiting.len() > MOST {
            self.waiting.pop_front();
        }
    }

    /// Those that wait.
    pub fn take(&mut self) -> Vec<NearScan> {
        self.waiting.drain(..).collect()
    }

    /// Those of the first scan with returns.
    pub fn beams(&self) -> Option<Beams> {
        self.beams
    }
}

fn beams(cloud: &Cloud) -> Option<Beams> {
    let returns = cloud.points.iter().filter(|p| Cloud::is_return(p));
    let mut all: Vec<f32> = returns.map(|[x, y, z]| z.atan2(x.hypot(*y))).collect();
    all.sort_unstable_by(f32::total_cmp);
    let at = |share: f64| all.get((share * all.len().saturating_sub(1) as f64) as usize).map(|e| f64::from(*e));
    let elevations = [at(OUTLIERS)?, at(1.0 - OUTLIERS)?];
    let span = elevations[1] - elevations[0];
    let rings = cloud.ring.iter().flatten().collect::<HashSet<_>>().len();
    let spread = (span * std::f64::consts::TAU / all.len() as f64).sqrt();
    Some(Beams { elevations, spacing: if rings > 1 { spread.max(span / (rings - 1) as f64) } else { spread } })
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
        let [low, high] = scans.beams().unwrap().elevations;
        assert!((low + std::f64::consts::FRAC_PI_4).abs() < 1e-6 && (0.0..0.1).contains(&high), "{low} {high}");
    }

    #[test]
    fn beams_are_as_far_apart_as_rings_or_as_the_same_number_of_returns() {
        // 16 rings over 30 degrees, 900 columns.
        let directions = (0..16 * 900).map(|k| [(k / 900) as f32 * 2.0 - 15.0, (k % 900) as f32 * 0.4].map(f32::to_radians));
        let points = directions.map(|[e, a]| [e.cos() * a.cos(), e.cos() * a.sin(), e.sin()].map(|c| 5.0 * c)).collect();
        let cloud = Cloud { ring: Some((0..16 * 900).map(|k| k / 900).collect()), ..Cloud::from_points(points) };
        let spacing = |cloud: &Cloud| beams(cloud).unwrap().spacing.to_degrees();
        assert!((spacing(&cloud) - 2.0).abs() < 0.1, "{}", spacing(&cloud));
        let scattered = Cloud { ring: None, ..cloud };
        assert!((spacing(&scattered) - 0.87).abs() < 0.02, "{}", spacing(&scattered));
        assert_eq!(beams(&Cloud::default()), None);
    }
}
