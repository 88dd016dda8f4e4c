//! Poses by time, added as they arrive.

use std::collections::VecDeque;
use voxelastic::Pose;
use voxelastic::geometry::PoseChange;

/// Poses are not interpolated over gaps longer than this, seconds.
pub(crate) const LONGEST_GAP_S: f64 = 0.35;

/// Poses in the order of their times.
#[derive(Clone, Debug, Default)]
pub(crate) struct PoseTrack {
    times: VecDeque<f64>,
    poses: VecDeque<Pose>,
}

impl PoseTrack {
    /// Adds a pose. It replaces an earlier one of the same time.
    pub(crate) fn add(&mut self, time: f64, pose: Pose) {
        if !time.is_finite() {
            return;
        }
        let at = self.times.partition_point(|t| *t < time);
        if self.times.get(at) == Some(&time) {
            self.poses[at] = pose;
        } else {
            self.times.insert(at, time);
            self.poses.insert(at, pose);
        }
    }

    /// The same poses, read otherwise.
    pub(crate) fn changed(&self, change: &PoseChange) -> Self {
        let times = self.times.iter().map(|time| time - change.seconds).collect();
        Self { times, poses: self.poses.iter().map(|pose| change.apply(pose)).collect() }
    }

    /// Times of the first and the last pose.
    pub(crate) fn span(&self) -> Option<[f64; 2]> {
        Some([*self.times.front()?, *self.times.back()?])
    }

    /// Time of the last pose.
    pub(crate) fn newest(&self) -> Option<f64> {
        self.times.back().copied()
    }

    /// Removes poses older than `time`, except for the last one before it.
    pub(crate) fn remove_before(&mut self, time: f64) {
        let keep = self.times.partition_point(|t| *t < time).saturating_sub(1);
        self.times.drain(..keep);
        self.poses.drain(..keep);
    }

    /// The last pose.
    pub(crate) fn last(&self) -> Option<&Pose> {
        self.poses.back()
    }

    /// The pose at a time: interpolated between two neighbours no more than `gap` seconds apart, else the nearest within `tolerance` seconds.
    pub(crate) fn at(&self, time: f64, gap: f64, tolerance: f64) -> Option<Pose> {
        let after = self.times.partition_point(|t| *t < time);
        if self.times.get(after) == Some(&time) {
            return Some(self.poses[after]);
        }
        let before = after.checked_sub(1);
        let after = Some(after).filter(|k| *k < self.times.len());
        if let (Some(a), Some(b)) = (before, after)
            && self.times[b] - self.times[a] <= gap
        {
            return between(&self.poses[a], &self.poses[b], (time - self.times[a]) / (self.times[b] - self.times[a]));
        }
        let off = |k: &usize| (self.times[*k] - time).abs();
        let nearest = before.into_iter().chain(after).min_by(|a, b| off(a).total_cmp(&off(b)))?;
        (off(&nearest) <= tolerance).then(|| self.poses[nearest])
    }
}

/// Interpolates; `None` if the rotations are opposite.
fn between(a: &Pose, b: &Pose, fraction: f64) -> Option<Pose> {
    let translation = a.translation.vector.lerp(&b.translation.vector, fraction);
    Some(Pose::from_parts(translation.into(), a.rotation.try_slerp(&b.rotation, fraction, 1e-9)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn x(x: f64) -> Pose {
        Pose::translation(x, 0.0, 0.0)
    }

    #[test]
    fn poses_are_interpolated_in_any_order_of_arrival() {
        let mut track = PoseTrack::default();
        for t in [2.0, 1.0, 1.2, 1.1, 1.2] {
            track.add(t, x(t));
        }
        assert_eq!((track.times.len(), track.newest()), (4, Some(2.0)));
        let at = |t| track.at(t, LONGEST_GAP_S, 0.01).map(|p| p.translation.x);
        assert!((at(1.15).unwrap() - 1.15).abs() < 1e-12);
        assert_eq!((at(1.2), at(1.205), at(1.5), at(2.02)), (Some(1.2), Some(1.2), None, None));
        track.remove_before(1.15);
        assert_eq!(track.times.len(), 3);
    }
}
