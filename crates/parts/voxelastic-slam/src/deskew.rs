//! The returns of a scan that are used, moved to its time stamp.

use voxelastic::Cloud;
use voxelastic::geometry::Rigid;
use voxelastic::motion::Motion;

/// Steps into which a sweep is divided.
const STEPS: usize = 1024;

/// Writes the returns between two ranges (metres), moved to the time stamp where the points have times and the motion is known.
pub(crate) fn returns(cloud: &Cloud, motion: Option<&Motion>, [nearest, farthest]: [f64; 2], out: &mut Vec<[f32; 3]>) {
    let (low, high) = ((nearest as f32).powi(2), (farthest as f32).powi(2));
    let is_used = |p: &[f32; 3]| {
        let square = p[0] * p[0] + p[1] * p[1] + p[2] * p[2];
        square > low && square < high
    };
    if motion.is_some_and(|motion| deskew(cloud, motion, out)) {
        out.retain(is_used);
    } else {
        out.clear();
        out.extend(cloud.points.iter().filter(|p| is_used(p)));
    }
}

/// Writes the returns of a cloud whose points have times, in the lidar frame at the time stamp. False, and nothing is written, without times.
fn deskew(cloud: &Cloud, motion: &Motion, out: &mut Vec<[f32; 3]>) -> bool {
    let Some(times) = cloud.time.as_ref().filter(|times| times.len() == cloud.len()) else { return false };
    let finite = times.iter().copied().filter(|t| t.is_finite());
    let (begin, end) = finite.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), t| (low.min(t), high.max(t)));
    if begin >= end {
        return false;
    }
    let per_second = STEPS as f32 / (end - begin);
    let poses: Vec<Rigid> = (0..STEPS).map(|k| Rigid::from(&motion.at(begin + (k as f32 + 0.5) / per_second))).collect();
    let returns = cloud.points.iter().zip(times).filter(|(p, t)| t.is_finite() && Cloud::is_return(p));
    out.clear();
    out.extend(returns.map(|(p, t)| poses[(((t - begin) * per_second) as usize).min(STEPS - 1)].apply(*p)));
    true
}

/// First and last time of a cloud's points, seconds after its stamp; `None` if they have none or are simultaneous.
pub(crate) fn sweep_span(cloud: &Cloud) -> Option<[f64; 2]> {
    let times = cloud.time.as_ref().filter(|times| times.len() == cloud.len())?;
    let finite = times.iter().copied().filter(|t| t.is_finite());
    let (begin, end) = finite.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), t| (low.min(t), high.max(t)));
    (begin < end).then(|| [begin, end].map(f64::from))
}
