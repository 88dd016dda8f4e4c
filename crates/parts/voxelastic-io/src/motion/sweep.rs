//! The lidar's motion during a sweep, from the poses around it.

use voxelastic::{Cloud, Motion, Pose};

/// Interval at which the motion is sampled, seconds.
const STEP_S: f32 = 0.005;
/// Largest number of samples.
const MOST_STEPS: usize = 1000;

/// First and last time of a cloud's points, seconds after its stamp; `None` if they have no times or are simultaneous.
pub(crate) fn time_span(cloud: &Cloud) -> Option<(f32, f32)> {
    let times = cloud.time.as_ref()?.iter().zip(&cloud.points).filter(|(t, p)| t.is_finite() && Cloud::is_return(p)).map(|(t, _)| *t);
    let (low, high) = times.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), t| (low.min(t), high.max(t)));
    (low < high).then_some((low, high))
}

/// The lidar's motion during the sweep of a cloud stamped `time`, if poses (`pose_at`, by seconds) are known from the sweep's start to its end.
pub(crate) fn sweep_motion(cloud: &Cloud, time: f64, t_map_lidar: &Pose, mut pose_at: impl FnMut(f64) -> Option<Pose>) -> Option<Motion> {
    let (low, high) = time_span(cloud)?;
    let count = (((high - low) / STEP_S).ceil() as usize).clamp(1, MOST_STEPS);
    let times = (0..=count).map(|k| low + (high - low) * k as f32 / count as f32);
    let samples: Option<Vec<(f32, Pose)>> = times.map(|t| pose_at(time + f64::from(t)).map(|pose| (t, t_map_lidar.inv_mul(&pose)))).collect();
    Motion::through(samples?)
}
