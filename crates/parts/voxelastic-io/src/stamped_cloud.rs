//! A cloud with the time that it was taken.

use voxelastic::Cloud;

/// A cloud's own stamp that differs from the time of its scan by more than this comes from another clock, seconds.
const SAME_CLOCK_S: f64 = 1.0;

/// A cloud and, where its file says so, when it was taken.
#[derive(Clone, Debug, PartialEq)]
pub struct StampedCloud {
    /// The points, in the lidar frame.
    pub cloud: Cloud,
    /// Time in seconds that [`Cloud::time`] counts from. Present only if the file holds absolute times.
    pub stamp: Option<f64>,
}

impl StampedCloud {
    /// The cloud with point times relative to `time`, seconds, if its own stamp comes from the same clock.
    pub(crate) fn relative_to(self, time: f64) -> Cloud {
        let Self { mut cloud, stamp } = self;
        if let (Some(times), Some(shift)) = (&mut cloud.time, stamp.map(|s| s - time).filter(|d| d.abs() <= SAME_CLOCK_S)) {
            times.iter_mut().for_each(|t| *t += shift as f32);
        }
        cloud
    }
}
