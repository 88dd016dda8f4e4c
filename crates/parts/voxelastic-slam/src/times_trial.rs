//! What the times of points mean, by the surfaces: scans are registered under several readings of their times, and the one under which they lie best on each other wins.

use crate::odometry::{Odometry, OdometrySettings, Status};
use crate::pose_check::middle;
use std::collections::VecDeque;
use voxelastic::geometry::{Pose, PoseExt};
use voxelastic::{Cloud, Motion};

/// Scans between which the lidar moves less than this tell nothing: metres, radians.
const LEAST_MOTION: (f64, f64) = (0.05, 0.01);
/// Fewer scans than this decide nothing.
const LEAST_SCANS: usize = 5;
/// So many neighbouring scans say about the same: their surfaces are met by several of them.
const SAME: f64 = 3.0;
/// A reading is better if surfaces are sharper by more than this ..
const LEAST_SHARPER: f64 = 0.02;
/// .. and by so many standard deviations of what the scans say, and so many more divided by how many scans there are: few do not tell how they scatter.
const LEAST_SIGMAS: f64 = 3.0;
const MORE_SIGMAS: f64 = 12.0;

/// Scans registered under several readings of the times of their points.
pub struct TimesTrial {
    readings: Vec<Reading>,
    /// The last scans, whose motion is known once the next one came.
    recent: VecDeque<(Cloud, f64)>,
}

struct Reading {
    /// Times are multiplied by this; 0: clouds are undistorted already.
    factor: f32,
    /// Finds how the lidar moved; its poses of the last scans, none where they could not be registered.
    first: Odometry,
    poses: VecDeque<Option<Pose>>,
    /// Takes the scans as they are with the motion that they turned out to have.
    second: Odometry,
    /// How far surfaces are apart, in metres, scan by scan: where the lidar moved, and all readings could be registered.
    spreads: Vec<f64>,
}

/// What a trial has shown.
#[derive(Clone, Debug, PartialEq)]
pub struct TimesVerdict {
    /// Scans that tell something.
    pub scans: usize,
    /// How far surfaces are apart under each reading, in the middle, metres.
    pub spreads: Vec<f64>,
    /// The reading that is better than each of the others.
    pub best: Option<usize>,
}

impl TimesTrial {
    /// Readings under which times are multiplied by these factors; 0: clouds are undistorted already.
    pub fn new(factors: &[f32]) -> Self {
        let odometry = |deskew| Odometry::new(OdometrySettings { deskew, ..OdometrySettings::default() });
        let reading =
            |&factor: &f32| Reading { factor, first: odometry(factor != 0.0), poses: VecDeque::new(), second: odometry(false), spreads: Vec::new() };
        Self { readings: factors.iter().map(reading).collect(), recent: VecDeque::new() }
    }

    /// Takes the next scan, with points as they were measured and times in seconds.
    pub fn add(&mut self, cloud: &Cloud, time: f64) {
        for reading in &mut self.readings {
            let report = reading.first.register(&reading.scaled(cloud), Some(time));
            reading.poses.push_back((report.status == Status::Tracked).then_some(report.t_map_lidar));
        }
        self.recent.push_back((cloud.clone(), time));
        if self.recent.len() == 3 {
            self.compare();
            self.recent.pop_front();
            for reading in &mut self.readings {
                reading.poses.pop_front();
            }
        }
    }

    /// Compares the last scan but one.
    fn compare(&mut self) {
        let times: Vec<f64> = self.recent.iter().map(|(_, time)| *time).collect();
        let mut spreads = Vec::new();
        for reading in &mut self.readings {
            let Some((cloud, moves)) = reading.undistorted(&self.recent[1].0, &times) else { continue };
            let report = reading.second.register(&cloud, Some(times[1]));
            spreads.extend((report.status == Status::Tracked && moves).then_some(report.spread));
        }
        if spreads.len() == self.readings.len() {
            self.readings.iter_mut().zip(spreads).for_each(|(reading, spread)| reading.spreads.push(spread));
        }
    }

    /// Scans so far that tell something.
    pub fn scans(&self) -> usize {
        self.readings.first().map_or(0, |reading| reading.spreads.len())
    }

    /// What they tell.
    pub fn verdict(&self) -> TimesVerdict {
        let wins =
            |k: &usize| (0..self.readings.len()).all(|other| other == *k || is_sharper(&self.readings[*k].spreads, &self.readings[other].spreads));
        let spread = |reading: &Reading| middle(reading.spreads.iter().copied());
        TimesVerdict { scans: self.scans(), spreads: self.readings.iter().map(spread).collect(), best: (0..self.readings.len()).find(wins) }
    }
}

impl Reading {
    /// The cloud with the times that it has under this reading.
    fn scaled(&self, cloud: &Cloud) -> Cloud {
        let times = cloud.time.as_ref().map(|times| times.iter().map(|t| t * self.factor).collect());
        Cloud { time: times, ..cloud.clone() }
    }

    /// The cloud in the middle of three with these times, undistorted by the poses of all three, and whether the lidar moved; none where one has no pose.
    fn undistorted(&self, cloud: &Cloud, times: &[f64]) -> Option<(Cloud, bool)> {
        let [before, now, after] = [0, 1, 2].map(|k| self.poses.get(k).copied().flatten());
        let (before, now, after) = (before?, now?, after?);
        let moves = now.translation_distance(&after) > LEAST_MOTION.0 || now.rotation_distance(&after) > LEAST_MOTION.1;
        let at = |k: usize, pose: &Pose| ((times[k] - times[1]) as f32, now.inv_mul(pose));
        let motion = Motion::through(vec![at(0, &before), (0.0, Pose::identity()), at(2, &after)]);
        let cloud = Cloud { motion, ..self.scaled(cloud) };
        let points = cloud.undistorted().filter(|_| self.factor != 0.0).map_or(cloud.points, |moved| moved.points);
        Some((Cloud { points, ..Cloud::default() }, moves))
    }
}

/// Whether the first spreads are smaller than the second, scan by scan and beyond doubt.
fn is_sharper(spreads: &[f64], others: &[f64]) -> bool {
    let gains: Vec<f64> = spreads.iter().zip(others).map(|(a, b)| (b / a).ln()).filter(|gain| gain.is_finite()).collect();
    let count = gains.len() as f64;
    let mean = gains.iter().sum::<f64>() / count;
    let variance = gains.iter().map(|gain| (gain - mean).powi(2)).sum::<f64>() / count;
    gains.len() >= LEAST_SCANS && mean > LEAST_SHARPER && mean > (LEAST_SIGMAS + MORE_SIGMAS / count) * (variance * SAME / count).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reading_is_better_only_beyond_doubt() {
        let scatter = |k: usize| 1.0 + 0.05 * ((k * 7919) as f64).sin();
        let spreads = |size: f64, count: usize| -> Vec<f64> { (0..count).map(|k| size * scatter(k)).collect() };
        let other: Vec<f64> = (0..40).map(|k| 0.1 * scatter(k + 100)).collect();
        assert!(is_sharper(&spreads(0.09, 40), &other));
        assert!(!is_sharper(&spreads(0.099, 40), &other), "by one percent");
        assert!(!is_sharper(&spreads(0.09, 4), &other) && !is_sharper(&spreads(0.095, 6), &other), "too few scans");
        assert!(is_sharper(&spreads(0.05, 6), &other), "few scans, but a half");
        assert!(!is_sharper(&other, &spreads(0.09, 40)));
        let wild: Vec<f64> = (0..40).map(|k| 0.097 * (1.0 + 0.5 * ((k * 7919) as f64).sin())).collect();
        assert!(!is_sharper(&wild, &other), "some scans say the one, some the other");
    }
}
