//! Poses around a sweep as the motion of its cloud.

use voxelastic::{Cloud, Motion, Pose};

/// The motion during a sweep is sampled this often, seconds.
const STEP_S: f32 = 0.005;
/// No sweep needs more samples.
const MOST_STEPS: usize = 1000;

/// First and last time of a cloud's points, seconds after its stamp; none if they have no times or all the same one.
pub(crate) fn span(cloud: &Cloud) -> Option<(f32, f32)> {
    let times = cloud.time.as_ref()?.iter().zip(&cloud.points).filter(|(t, p)| t.is_finite() && Cloud::is_return(p)).map(|(t, _)| *t);
    let (low, high) = times.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), t| (low.min(t), high.max(t)));
    (low < high).then_some((low, high))
}

/// How the lidar moved while a cloud was taken at `time`, if poses (`pose_at`, seconds) are known from the beginning of its sweep to the end.
pub(crate) fn motion(cloud: &Cloud, time: f64, t_map_lidar: &Pose, mut pose_at: impl FnMut(f64) -> Option<Pose>) -> Option<Motion> {
    let (low, high) = span(cloud)?;
    let count = (((high - low) / STEP_S).ceil() as usize).clamp(1, MOST_STEPS);
    let times = (0..=count).map(|k| low + (high - low) * k as f32 / count as f32);
    let samples: Option<Vec<(f32, Pose)>> = times.map(|t| pose_at(time + f64::from(t)).map(|pose| (t, t_map_lidar.inv_mul(&pose)))).collect();
    Motion::through(samples?)
}
