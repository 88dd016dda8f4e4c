//! A cloud with the time that it was taken.

use crate::motion::time_span;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use voxelastic::Cloud;

/// A cloud's own stamp that differs from the time of its scan by more than this comes from another clock, seconds.
const SAME_CLOCK_S: f64 = 1.0;
/// Time between clouds without times, seconds: most sensors turn ten times a second.
pub(crate) const ASSUMED_PERIOD_S: f64 = 0.1;
/// Times between clouds that a sweep may fill, seconds: of clouds farther apart some were left out.
const SWEEPS: [f64; 2] = [0.02, 0.3];
/// The earliest point of a cloud that comes this share of the interval after its stamp, or more, is not of its sweep by those times: they run on from cloud to cloud.
const RUNS_ON: f32 = 0.95;
/// So many intervals say what is usual.
const INTERVALS: usize = 9;
/// A sweep lasts no longer than this many intervals between clouds: scans overlap a little, and clocks jitter.
const MOST_INTERVALS: f64 = 1.3;
/// A sweep that fills less of the interval between clouds is one of a part of the circle or of every second cloud, or its times are in another unit.
const LEAST_INTERVALS: f64 = 0.6;
/// Whether a sweep that the interval contradicts was said, and shares of unknown sweeps: it is so of every cloud of a data set.
static SAID_MISFIT: AtomicBool = AtomicBool::new(false);
static SAID_SHARES: AtomicBool = AtomicBool::new(false);

/// A cloud and, where its file says so, when it was taken.
#[derive(Clone, Debug, PartialEq)]
pub struct StampedCloud {
    /// The points, in the lidar frame.
    pub cloud: Cloud,
    /// Time in seconds that [`Cloud::time`] counts from. Present only if the file holds absolute times.
    pub stamp: Option<f64>,
    /// Whether [`Cloud::time`] are shares of the sweep, 0 to 1, as some drivers and data sets have them, and not seconds.
    pub has_shares: bool,
    /// Whether [`Cloud::time`] was in a field called curvature, where FAST-LIO keeps the times of clouds that it has undistorted.
    pub times_in_curvature: bool,
}

/// Whether a sweep of so many seconds, by the times of its points, does not last as long as it takes until the next cloud comes, seconds. Of clouds that come more rarely than sensors
/// turn, a part was left out.
pub fn contradicts_interval(sweep_s: f64, interval_s: f64) -> bool {
    let is_short = sweep_s < LEAST_INTERVALS * interval_s && (SWEEPS[0]..=SWEEPS[1]).contains(&interval_s);
    is_short || sweep_s > MOST_INTERVALS * interval_s
}

/// How long the sweeps of a sensor take.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SweepTime {
    /// The usual time between its clouds, seconds, if it is known.
    pub(crate) interval_s: Option<f64>,
    /// Whether times of points are stretched, so that a sweep takes that long.
    pub(crate) is_stretched: bool,
}

impl StampedCloud {
    /// A cloud with times in seconds, from a stamp on, if it has any.
    pub(crate) fn new(cloud: Cloud, stamp: Option<f64>) -> Self {
        Self { cloud, stamp, has_shares: false, times_in_curvature: false }
    }

    /// Says once if the sweep contradicts the interval between clouds: of clouds that are not looked at before they are mapped.
    pub(crate) fn tell_misfit(&self, interval_s: f64) {
        let Some((low, high)) = time_span(&self.cloud).filter(|_| !self.has_shares) else { return };
        let sweep_s = f64::from(high - low);
        if contradicts_interval(sweep_s, interval_s) && !SAID_MISFIT.swap(true, Ordering::Relaxed) {
            tracing::warn!(
                "a sweep takes {sweep_s:.3} s by the times of its points, but clouds come every {interval_s:.3} s: right if the sensor looks at a part of the circle, else the times are in another \
                 unit; say what they mean with --point-times"
            );
        }
    }

    /// The cloud with point times relative to `time`, seconds, if its own stamp comes from the same clock. Shares become seconds if it is known how long a sweep takes,
    /// which is the interval between clouds; else they are left out. Times that run on from cloud to cloud count from the earliest point.
    pub(crate) fn relative_to(self, time: f64, SweepTime { interval_s: interval, is_stretched }: SweepTime) -> Cloud {
        let Self { mut cloud, stamp, has_shares, .. } = self;
        let has_shares = has_shares || (is_stretched && become_shares(&mut cloud));
        if has_shares {
            match (&mut cloud.time, interval) {
                (Some(times), Some(interval)) => times.iter_mut().for_each(|t| *t *= interval as f32),
                _ => {
                    cloud.time = None;
                    if !SAID_SHARES.swap(true, Ordering::Relaxed) {
                        let words = "but how long a sweep takes is not known, so they are left out and clouds are not undistorted";
                        tracing::warn!(
                            "times of points are from 0 to 1, which is a share of the sweep, {words}; write them in seconds, or in ns as whole numbers"
                        );
                    }
                }
            }
        }
        if let Some(times) = cloud.time.as_mut().filter(|_| stamp.is_none()) {
            let earliest = times.iter().zip(&cloud.points).filter(|(_, p)| Cloud::is_return(p)).fold(f32::INFINITY, |low, (t, _)| low.min(*t));
            if earliest.is_finite() && earliest >= RUNS_ON * interval.unwrap_or(SWEEPS[1]) as f32 {
                times.iter_mut().for_each(|t| *t -= earliest);
            }
        }
        if let (Some(times), Some(shift)) = (&mut cloud.time, stamp.map(|s| s - time).filter(|d| d.abs() <= SAME_CLOCK_S)) {
            times.iter_mut().for_each(|t| *t += shift as f32);
        }
        cloud
    }
}

/// Makes the times of points shares of their sweep: by the first and the last of the returns.
fn become_shares(cloud: &mut Cloud) -> bool {
    let Some((low, high)) = time_span(cloud) else { return false };
    cloud.time.iter_mut().flatten().for_each(|t| *t = (*t - low) / (high - low));
    true
}

/// The usual time between the clouds of a sensor, from those that came.
#[derive(Clone, Debug, Default)]
pub(crate) struct Interval {
    last: Option<f64>,
    recent: VecDeque<f64>,
}

impl Interval {
    /// Notes a cloud of this time, seconds, and returns what is usual, if a sweep can take that long.
    pub(crate) fn after(&mut self, time: f64) -> Option<f64> {
        if let Some(last) = self.last.replace(time) {
            self.recent.push_back(time - last);
            if self.recent.len() > INTERVALS {
                self.recent.pop_front();
            }
        }
        self.usual()
    }

    /// What is usual, seconds, if a sweep can take that long.
    pub(crate) fn usual(&self) -> Option<f64> {
        let mut sorted: Vec<f64> = self.recent.iter().copied().collect();
        sorted.sort_by(f64::total_cmp);
        sorted.get(sorted.len() / 2).copied().filter(|s| (SWEEPS[0]..=SWEEPS[1]).contains(s))
    }

    /// The same before the first cloud of another reading.
    pub(crate) fn before_first(&self) -> Self {
        Self { last: None, recent: self.recent.clone() }
    }

    /// What is usual, seconds, once one lost cloud does not change it.
    pub(crate) fn settled(&self) -> Option<f64> {
        self.usual().filter(|_| self.recent.len() > INTERVALS / 2)
    }

    /// Whether two clouds came.
    pub(crate) fn is_known(&self) -> bool {
        !self.recent.is_empty()
    }

    /// The same of clouds whose times are all known.
    pub(crate) fn of(times: &[f64]) -> Option<f64> {
        let mut between: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
        between.sort_by(f64::total_cmp);
        between.get(between.len() / 2).copied().filter(|s| (SWEEPS[0]..=SWEEPS[1]).contains(s))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_of_the_interval_between_clouds() {
        let cloud = Cloud { points: vec![[1.0, 2.0, 3.0]; 3], time: Some(vec![0.0, 0.5, 1.0]), ..Cloud::default() };
        let shares = StampedCloud { has_shares: true, ..StampedCloud::new(cloud, None) };
        let mut interval = Interval::default();
        let of = |interval_s| SweepTime { interval_s, is_stretched: false };
        assert_eq!(interval.after(10.0), None);
        let usual = [10.05, 10.1, 10.15, 10.35].map(|time| interval.after(time));
        assert!(usual.into_iter().flatten().all(|s| (s - 0.05).abs() < 1e-9), "one that was lost does not count: {usual:?}");
        assert_eq!(interval.before_first().after(99.0), usual[3], "what the beginning showed holds for its first cloud");
        assert_eq!(shares.clone().relative_to(0.0, of(usual[3])).time.unwrap(), [0.0, 0.025, 0.05]);
        assert_eq!(shares.relative_to(0.0, of(None)).time, None);
    }

    #[test]
    fn times_are_stretched_over_the_interval() {
        let cloud = Cloud { points: vec![[1.0, 2.0, 3.0]; 3], time: Some(vec![-0.02, 0.0, 0.02]), ..Cloud::default() };
        let stretched = StampedCloud::new(cloud, None).relative_to(3.0, SweepTime { interval_s: Some(0.1), is_stretched: true });
        assert_eq!(stretched.time.unwrap(), [0.0, 0.05, 0.1]);
    }

    #[test]
    fn times_that_run_on_from_cloud_to_cloud_count_from_the_earliest_point() {
        let points = vec![[0.0; 3], [1.0, 2.0, 3.0], [1.0, 2.0, 3.0]];
        let at =
            |from: f32| StampedCloud::new(Cloud { points: points.clone(), time: Some(vec![0.0, from, from + 0.0625]), ..Cloud::default() }, None);
        assert_eq!(at(0.5).relative_to(7.0, SweepTime { interval_s: Some(0.1), is_stretched: false }).time.unwrap()[1..], [0.0, 0.0625]);
        assert_eq!(at(0.5).relative_to(7.0, SweepTime::default()).time.unwrap()[1..], [0.0, 0.0625]);
        assert_eq!(
            at(0.05).relative_to(7.0, SweepTime { interval_s: Some(0.1), is_stretched: false }).time.unwrap()[1..],
            [0.05, 0.1125],
            "a sensor that looks at half of the circle"
        );
    }

    #[test]
    fn what_clouds_came_says_the_interval() {
        assert_eq!((Interval::of(&[0.0, 2.0, 4.0]), Interval::of(&[0.0, 0.1, 0.2])), (None, Some(0.1)), "keyframes say nothing");
    }
}
