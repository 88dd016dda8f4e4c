//! A LiDAR cloud as it enters the system, before any projection.

use crate::Motion;
use serde::{Deserialize, Serialize};

/// A LiDAR cloud in the lidar frame L, in metres.
///
/// Optional channels are either absent or exactly as long as [`Cloud::points`]. A point with a NaN or all-zero
/// coordinate is "no return"; it is kept so that an organised cloud keeps its pixel grid.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Cloud {
    /// Coordinates x, y, z in the lidar frame, metres.
    pub points: Vec<[f32; 3]>,
    /// Columns of an organised cloud; for an unorganised cloud the number of points.
    pub width: usize,
    /// Rows (rings) of an organised cloud; 1 for an unorganised cloud. Row-major: point `row * width + column`.
    pub height: usize,
    /// Return strength in the sensor's own scale (intensity or reflectivity).
    pub intensity: Option<Vec<f32>>,
    /// Colour of each point, sRGB; [0, 0, 0] where it has none.
    pub colours: Option<Vec<[u8; 3]>>,
    /// Ring (row) of each point, 0-based, in the sensor's own order.
    pub ring: Option<Vec<u16>>,
    /// Time of each point in seconds, relative to the cloud's time stamp.
    pub time: Option<Vec<f32>>,
    /// Motion of the lidar during the sweep, if known: the cloud is then undistorted by the times of its points when it is mapped.
    pub motion: Option<Motion>,
    /// Which of the sensors of a run measured it, 0 if there is one: each has its own beam model.
    pub sensor: u16,
}

impl Cloud {
    /// An unorganised cloud of bare points.
    pub fn from_points(points: Vec<[f32; 3]>) -> Self {
        Self { width: points.len(), height: 1, points, ..Self::default() }
    }

    /// Number of points, returns or not.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether the cloud holds no point at all.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Whether the points form a grid of rings x columns.
    pub fn is_organised(&self) -> bool {
        self.height > 1 && self.width * self.height == self.points.len()
    }

    /// Whether `p` is a measured return: finite and not the origin.
    #[inline]
    pub fn is_return([x, y, z]: &[f32; 3]) -> bool {
        // Without a branch: which points are returns is as good as random.
        (x.is_finite() & y.is_finite() & z.is_finite()) & ((*x != 0.0) | (*y != 0.0) | (*z != 0.0))
    }

    /// Computes the points, each measured in the lidar frame of its own time, in the lidar frame at the time stamp, and the position of the lidar at
    /// each of them. Returns false and changes nothing if the motion is unknown or if the points have no times or all the same time.
    pub(crate) fn undistort_into(&self, points: &mut Vec<[f32; 3]>, origins: &mut Vec<[f32; 3]>) -> bool {
        let Some(motion) = &self.motion else { return false };
        let Some(times) = self.time.as_ref().filter(|t| t.len() == self.len()) else { return false };
        let finite = || times.iter().zip(&self.points).filter(|(t, p)| t.is_finite() && Self::is_return(p)).map(|(t, _)| *t);
        let (low, high) = finite().fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), t| (low.min(t), high.max(t)));
        if low >= high {
            return false;
        }
        let motion = motion.sampled(low, high);
        points.clear();
        // Points without a return stay as they are: an organised cloud keeps its grid.
        points.extend(self.points.iter().zip(times).map(|(p, t)| if Self::is_return(p) { motion.pose(*t).apply(*p) } else { *p }));
        origins.clear();
        origins.extend(times.iter().map(|t| motion.pose(*t).translation));
        true
    }

    /// The cloud in the lidar frame at its time stamp; none if the motion or the times of the points are unknown.
    pub fn undistorted(&self) -> Option<Self> {
        let (mut points, mut origins) = (Vec::new(), Vec::new());
        self.undistort_into(&mut points, &mut origins).then(|| Self { points, motion: None, time: None, ..self.clone() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Pose;
    use nalgebra::{Point3, Translation3, UnitQuaternion};

    /// 3 m/s along x and 90 degrees a second about z.
    fn riding(t: f64) -> Pose {
        Pose::from_parts(Translation3::new(3.0 * t, 0.0, 0.0), UnitQuaternion::from_euler_angles(0.0, 0.0, t * std::f64::consts::FRAC_PI_2))
    }

    #[test]
    fn an_undistorted_point_of_the_world_stays_in_place() {
        let motion = Motion::through((0..=10).map(|k| (k as f32 * 0.01, riding(0.01 * f64::from(k))))).unwrap();
        // One corner of the world, measured at many times of the sweep.
        let corner = Point3::new(8.0, -3.0, 1.0);
        let times: Vec<f32> = (0..1000).map(|k| k as f32 * 1e-4).collect();
        let seen = |t: &f32| riding(f64::from(*t)).inverse() * corner;
        let mut cloud = Cloud::from_points(times.iter().map(seen).map(|p| [p.x as f32, p.y as f32, p.z as f32]).collect());
        cloud.points[500] = [f32::NAN; 3];
        cloud.time = Some(times);
        cloud.motion = Some(motion);
        let still = cloud.undistorted().unwrap();
        let off = |p: &[f32; 3]| (0..3).map(|k| f64::from(p[k]) - corner[k]).map(|d| d * d).sum::<f64>().sqrt();
        let worst = still.points.iter().filter(|p| Cloud::is_return(p)).map(off).fold(0.0, f64::max);
        assert!(worst < 4e-4, "{worst} m");
        assert!(off(&cloud.points[999]) > 1.0 && still.points[500][0].is_nan() && still.undistorted().is_none());
    }

    #[test]
    fn without_different_times_there_is_nothing_to_undistort() {
        let motion = Motion::through([(0.0, Pose::identity()), (0.1, riding(0.1))]);
        let mut cloud = Cloud { motion, ..Cloud::from_points(vec![[1.0, 0.0, 0.0]; 3]) };
        assert!(cloud.undistorted().is_none());
        cloud.time = Some(vec![0.05; 3]);
        assert!(cloud.undistorted().is_none());
    }
}
