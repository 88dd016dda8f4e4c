//! Some of the data, looked at before anything is mapped.

use super::{Inputs, Source};
use crate::input::Input;
use voxelastic::event::Event;
use voxelastic::geometry::PoseExt;
use voxelastic::{Cloud, Pose};
use voxelastic_io::dataset::{Dataset, ScanEntry};
use voxelastic_io::source::Source as RegisteredSource;
use voxelastic_slam::pose_check::{CheckScan, PoseCheck, is_apart};

/// Pairs of scans that are compared: at least, at most, and one for so many scans.
const PAIRS: (usize, usize, usize) = (6, 12, 12);
/// The two scans of a pair are at most so many apart.
const MOST_APART: usize = 5;
/// Scans of a recording, or without poses, that are read from their beginning.
const FROM_BEGINNING: usize = 12;

/// What some of the data look like.
#[derive(Clone, Debug)]
pub struct Examination {
    /// What a comparison of the poses with the scans has shown; none where there are no poses.
    pub poses: Option<PoseCheck>,
    /// The scans that were read for it.
    pub sample: Sample,
}

/// Scans that were read, in pairs that are compared, and the poses of all.
#[derive(Clone, Debug, Default)]
pub struct Sample {
    /// Times, seconds, and poses of the lidar in the map.
    pub track: Vec<(f64, Pose)>,
    /// Whether the times are those of a clock.
    pub has_times: bool,
    /// Pairs of scans, thinned.
    pub pairs: Vec<(CheckScan, CheckScan)>,
    /// The clouds that were read.
    pub clouds: Vec<SampledCloud>,
    /// The usual time between clouds, seconds, where all of them are known.
    pub interval_s: Option<f64>,
    /// What speaks for clouds that are undistorted already, although their points have times.
    pub(super) undistorted_sign: Option<String>,
    /// The longest time between two neighbouring scans without poses, seconds, if their times are known.
    pub(super) longest_pause_s: Option<f64>,
}

/// What one cloud looks like.
#[derive(Clone, Copy, Debug)]
pub struct SampledCloud {
    /// Its returns.
    pub returns: usize,
    /// 95 % of them are within this range, metres.
    pub range_m: f32,
    /// The time from its first to its last point, seconds; none where points have no times.
    pub sweep_s: Option<f64>,
    /// Whether it is known how the lidar moved meanwhile.
    pub has_motion: bool,
}

impl Sample {
    /// The time from the first to the last point of a cloud, in the middle of all that have times, seconds.
    pub fn sweep_s(&self) -> Option<f64> {
        middle(self.clouds.iter().filter_map(|cloud| cloud.sweep_s).collect())
    }

    /// Whether there are poses, but most clouds whose points have times do not get the lidar's motion by them.
    pub(super) fn lacks_motion(&self) -> bool {
        let timed = || self.clouds.iter().filter(|cloud| cloud.sweep_s.is_some());
        !self.track.is_empty() && 2 * timed().filter(|cloud| !cloud.has_motion).count() > timed().count()
    }

    fn add(&mut self, index: usize, cloud: &Cloud) -> CheckScan {
        let returns = cloud.points.iter().filter(|p| Cloud::is_return(p));
        let mut ranges: Vec<f32> = returns.map(|p| p.iter().map(|v| v * v).sum::<f32>().sqrt()).collect();
        ranges.sort_by(f32::total_cmp);
        let bounds =
            cloud.time.as_ref().map(|times| times.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), t| (low.min(*t), high.max(*t))));
        let sweep_s = bounds.map(|(low, high)| f64::from(high - low)).filter(|sweep| *sweep > 0.0);
        let range_m = ranges.get(ranges.len() * 95 / 100).copied().unwrap_or(0.0);
        self.clouds.push(SampledCloud { returns: ranges.len(), range_m, sweep_s, has_motion: cloud.motion.is_some() });
        CheckScan::new(index, cloud)
    }
}

impl Source {
    /// Reads some of the scans, `times` as many as usual.
    pub(super) fn sample(&self, times: usize) -> Sample {
        match self {
            Self::Registered(source) => {
                let sample = match &**source {
                    RegisteredSource::Folder(folder) => of_folder(folder, times),
                    recording => of_recording(recording, times),
                };
                Sample { undistorted_sign: source.undistorted_sign(), ..sample }
            }
            Self::Raw(raw) => {
                Sample { longest_pause_s: raw.longest_pause_s(), undistorted_sign: raw.undistorted_sign(), ..of_raw(self.inputs(), raw.interval_s()) }
            }
        }
    }
}

/// The beginning of a recording with poses.
fn of_recording(recording: &RegisteredSource, times: usize) -> Sample {
    let mut sample = Sample { has_times: true, interval_s: recording.interval_s(), ..Sample::default() };
    let mut scans = Vec::new();
    let came = recording.preview().filter_map(|event| if let Ok(Event::Scan(scan)) = event { Some(scan) } else { None });
    for scan in came.take(FROM_BEGINNING * times) {
        scans.push(sample.add(scans.len(), &scan.cloud));
        sample.track.push((scan.time, scan.t_map_lidar));
    }
    sample.pairs = (0..scans.len().saturating_sub(1)).map(|k| (scans[k].clone(), scans[partner(&sample.track, k)].clone())).collect();
    sample
}

/// The beginning of scans without poses.
fn of_raw(inputs: Inputs, interval_s: Option<f64>) -> Sample {
    let mut sample = Sample { has_times: true, interval_s, ..Sample::default() };
    let came = inputs.filter_map(|input| if let Input::RawScan(scan, _) = input { Some(scan) } else { None });
    for scan in came.filter(|scan| scan.cloud.sensor == 0).take(FROM_BEGINNING) {
        sample.add(0, &scan.cloud);
    }
    sample
}

/// Pairs from all over a folder. Half of them are where the lidar turns most: only there it shows where it is on a vehicle.
fn of_folder(folder: &Dataset, times: usize) -> Sample {
    let scans: Vec<&ScanEntry> = folder.scans().iter().filter(|scan| scan.sensor == 0).collect();
    let track: Vec<(f64, Pose)> = scans.iter().map(|scan| (scan.time, scan.t_map_lidar)).collect();
    let (least, most, per) = PAIRS;
    let count = ((scans.len() / per).clamp(least, most) * times).min(scans.len().saturating_sub(1));
    let turn = |k: &usize| track[*k].1.rotation_distance(&track[partner(&track, *k)].1);
    let firsts = (0..count).map(|bin| {
        let (from, to) = (bin * (scans.len() - 1) / count, (bin + 1) * (scans.len() - 1) / count);
        let most_turned = (from..to).max_by(|a, b| turn(a).total_cmp(&turn(b)));
        if bin % 2 == 0 { usize::midpoint(from, to) } else { most_turned.unwrap_or(from) }
    });
    let firsts: Vec<usize> = firsts.collect();
    let mut sample = Sample { has_times: folder.has_times(), ..Sample::default() };
    let mut read = |k: usize| folder.cloud(scans[k]).ok().map(|cloud| sample.add(k, &cloud));
    let pairs = firsts.into_iter().filter_map(|first| Some((read(first)?, read(partner(&track, first))?))).collect();
    let came: Vec<f64> = track.iter().map(|(time, _)| *time).collect();
    let interval_s = if sample.has_times { folder.interval_s().or_else(|| interval(&came)) } else { None };
    Sample { track, pairs, interval_s, ..sample }
}

/// The scan that a scan is compared with: the next one, or one of those after it, if the lidar hardly moves.
fn partner(track: &[(f64, Pose)], first: usize) -> usize {
    let last = (first + MOST_APART).min(track.len() - 1);
    (first + 1..last).find(|k| is_apart(&track[first].1, &track[*k].1)).unwrap_or(last)
}

/// The usual time between clouds, seconds.
fn interval(times: &[f64]) -> Option<f64> {
    middle(times.windows(2).map(|pair| pair[1] - pair[0]).filter(|s| *s > 0.0).collect())
}

fn middle(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}
