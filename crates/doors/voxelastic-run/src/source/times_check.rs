//! Before mapping: what the times of points mean, and which reading of them holds where there are two.

use super::Source;
use super::sample::{Examination, Sample};
use crate::input::Input;
use crate::warning::{Code, Warnings};
use std::path::Path;
use voxelastic_io::{OpenOptions, PointTimes};
use voxelastic_slam::{TimesTrial, TimesVerdict};

/// A sweep lasts no longer than this many intervals between clouds: scans overlap a little, and clocks jitter.
const MOST_INTERVALS: f64 = 1.3;
/// A sweep that fills less of the interval between clouds is one of a part of the circle or of every second cloud, or its times are in another unit.
const LEAST_INTERVALS: f64 = 0.6;
/// Intervals at which sensors send clouds, seconds: those of keyframes say nothing.
const SENSOR_INTERVALS: std::ops::RangeInclusive<f64> = 0.02..=0.3;
/// Scans of a trial at most, and those among them that tell something.
const SCANS: usize = 150;
const TELLING: usize = 40;
/// The readings that a trial compares.
const READINGS: [PointTimes; 3] = [PointTimes::Given, PointTimes::OverInterval, PointTimes::Undistorted];

/// A sweep that does not take as long as it takes until the next cloud comes.
#[derive(Clone, Copy, Debug)]
struct Doubt {
    sweep_s: f64,
    interval_s: f64,
}

/// Says what the times of points mean, and returns another reading of them if surfaces are sharper under it.
pub(super) fn decide(found: &Examination, path: &Path, options: &OpenOptions, warnings: &mut Warnings) -> Option<PointTimes> {
    let Some(sweep) = found.sample.sweep_s() else {
        if !found.sample.clouds.is_empty() {
            tracing::info!("points have no times: clouds are taken as they are, undistorted or not");
        }
        return None;
    };
    tracing::info!("points have times: a sweep takes {:.1} ms", sweep * 1e3);
    let doubt = doubt(&found.sample)?;
    if options.point_times != PointTimes::Undecided {
        return None;
    }
    tracing::info!("{doubt}: looking at the surfaces of some scans");
    let verdict = trial(path, options, &[1.0, (doubt.interval_s / doubt.sweep_s) as f32, 0.0]);
    let shown = verdict.as_ref().map(shown).unwrap_or_default();
    match verdict.and_then(|verdict| verdict.best).map(|best| READINGS[best]) {
        Some(PointTimes::Given) => tracing::info!("they are right: {shown}"),
        Some(reading) => {
            let words = match reading {
                PointTimes::OverInterval => "so a sweep is taken to last until the next cloud comes",
                _ => "so clouds are taken to be compensated for motion already",
            };
            warnings.add(Code::TimesChanged, format!("{doubt}; {shown}, {words}"), "--point-times given takes the times as they are");
            return Some(reading);
        }
        None => {
            let why = if shown.is_empty() { "the scans do not tell which, as the sensor hardly moves in them".to_owned() } else { shown };
            let cause = if doubt.sweep_s > doubt.interval_s {
                "the times are in another unit, or of several sweeps"
            } else {
                "that is right if the sensor looks at a part of the circle, or clouds were left out; else the times are in another unit"
            };
            let remedy = "say which with --point-times given, over-interval or undistorted";
            warnings.add(Code::DoubtfulTimes, format!("{doubt}: {cause}; {why}"), remedy);
        }
    }
    None
}

/// Where nothing else is doubtful about the times of points: whether surfaces are sharper with clouds that are taken to be compensated for motion already. It takes as long as
/// the odometry of some hundred scans, so a run does not look.
pub fn check_compensation(found: &Examination, path: &Path, options: &OpenOptions, warnings: &mut Warnings) {
    if found.sample.sweep_s().is_none() || doubt(&found.sample).is_some() || options.point_times != PointTimes::Undecided {
        return;
    }
    let Some(verdict) = trial(path, options, &[1.0, 0.0]) else { return };
    let [as_given, compensated] = [0, 1].map(|k| verdict.spreads[k] * 100.0);
    let shown = format!("surfaces of {} scans are {as_given:.2} cm apart by the times of points, {compensated:.2} cm without", verdict.scans);
    if verdict.best == Some(1) {
        let text = format!("clouds seem to be compensated for motion already, although their points have times: {shown}");
        warnings.add(Code::DoubtfulTimes, text, "map with --point-times undistorted");
    } else {
        tracing::info!("{shown}");
    }
}

fn doubt(sample: &Sample) -> Option<Doubt> {
    let (sweep_s, interval_s) = (sample.sweep_s()?, sample.interval_s?);
    let is_short = sweep_s < LEAST_INTERVALS * interval_s && SENSOR_INTERVALS.contains(&interval_s);
    (is_short || sweep_s > MOST_INTERVALS * interval_s).then_some(Doubt { sweep_s, interval_s })
}

/// Registers some scans under each reading; none if they cannot be read without poses.
fn trial(path: &Path, options: &OpenOptions, factors: &[f32]) -> Option<TimesVerdict> {
    let options = OpenOptions {
        cloud_topic: options.cloud_topic.clone(),
        metadata: options.metadata.clone(),
        point_times: PointTimes::Given,
        use_imu: false,
        ..OpenOptions::default()
    };
    let source = Source::open(path, &options, Some(true)).ok()?;
    let mut trial = TimesTrial::new(factors);
    let scans = source.inputs().filter_map(|input| if let Input::RawScan(scan, _) = input { Some(scan) } else { None });
    for scan in scans.take(SCANS) {
        trial.add(&scan.cloud, scan.time);
        if trial.scans() >= TELLING {
            break;
        }
    }
    (trial.scans() > 0).then(|| trial.verdict())
}

/// What a trial has shown, in words.
fn shown(verdict: &TimesVerdict) -> String {
    let [given, over, none] = [0, 1, 2].map(|k| verdict.spreads[k] * 100.0);
    format!(
        "surfaces of {} scans are {given:.2} cm apart if the times are right, {over:.2} cm if a sweep lasts until the next cloud comes, and {none:.2} cm if clouds are compensated already",
        verdict.scans
    )
}

impl std::fmt::Display for Doubt {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "a sweep takes {:.3} s by the times of its points, but clouds come every {:.3} s", self.sweep_s, self.interval_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::SampledCloud;
    use voxelastic_io::pcd;
    use voxelastic_sim::sensor::LidarSettings;
    use voxelastic_sim::{PoseSource, SimOptions, Simulation};

    #[test]
    fn sweeps_that_do_not_fill_the_interval_between_clouds_are_doubted() {
        let is_doubted = |sweep_s: f64, interval_s: f64| {
            let cloud = SampledCloud { returns: 1000, range_m: 20.0, sweep_s: Some(sweep_s) };
            doubt(&Sample { clouds: vec![cloud; 5], interval_s: Some(interval_s), ..Sample::default() }).is_some()
        };
        for (sweep, interval) in [(0.1, 0.1), (0.098, 0.1), (0.05, 0.05), (0.1, 2.0), (0.07, 0.1)] {
            assert!(!is_doubted(sweep, interval), "{sweep} of {interval}");
        }
        assert!(is_doubted(0.2, 0.1) && is_doubted(0.05, 0.1));
    }

    /// A walk whose sweeps have times, of which `spoil` makes what it has; the interval between clouds is in the names of the files.
    fn walk(dir: &Path, every: usize, moving: bool, spoil: impl Fn(&mut voxelastic::Cloud)) {
        let walk = Simulation::new(SimOptions {
            sensor: "os1-32".into(),
            columns: Some(256),
            rate: Some(10.0),
            scans: Some(60),
            carrier: Some("handheld".into()),
            drift: 0.0,
            lidar: LidarSettings { moving, ..LidarSettings::default() },
            ..SimOptions::of("room")
        });
        let walk = walk.unwrap();
        for scan in walk.scans(PoseSource::Truth).step_by(every) {
            let mut cloud = scan.cloud;
            spoil(&mut cloud);
            pcd::write(dir.join(format!("{:.6}.pcd", 100.0 + scan.time)), &cloud).unwrap();
        }
    }

    #[test]
    fn surfaces_tell_what_times_mean() {
        let times = |factor: f32| move |cloud: &mut voxelastic::Cloud| cloud.time.iter_mut().flatten().for_each(|t| *t *= factor);
        let undistorted = |cloud: &mut voxelastic::Cloud| {
            let of = |k: usize| 0.05 * (k % cloud.width) as f32 / cloud.width as f32;
            cloud.time = Some((0..cloud.len()).map(of).collect());
        };
        type Spoil<'a> = &'a dyn Fn(&mut voxelastic::Cloud);
        let cases: [(&str, usize, Spoil<'_>, Option<PointTimes>); 4] = [
            ("half of the time", 1, &times(0.5), Some(PointTimes::OverInterval)),
            ("twice the time", 1, &times(2.0), Some(PointTimes::OverInterval)),
            ("undistorted", 1, &undistorted, Some(PointTimes::Undistorted)),
            ("every second cloud", 2, &times(1.0), None),
        ];
        for (name, every, spoil, expected) in cases {
            let dir = tempfile::tempdir().unwrap();
            walk(dir.path(), every, name != "undistorted", spoil);
            let mut warnings = Warnings::default();
            let options = OpenOptions::default();
            let found = Source::open(dir.path(), &options, None).unwrap().examine(&options);
            let reading = decide(&found, dir.path(), &options, &mut warnings);
            let said: Vec<&str> = warnings.all().iter().map(|warning| warning.text.as_str()).collect();
            println!("{name}: {reading:?}, {said:?}");
            assert_eq!(reading, expected, "{name}: {said:?}");
            assert_eq!(said.is_empty(), expected.is_none(), "{name}: {said:?}");
        }
    }
    #[test]
    fn clouds_that_are_compensated_and_still_have_times_are_told() {
        for moving in [true, false] {
            let dir = tempfile::tempdir().unwrap();
            let times = |cloud: &mut voxelastic::Cloud| {
                let of = |k: usize| 0.1 * (k % cloud.width) as f32 / cloud.width as f32;
                cloud.time = Some((0..cloud.len()).map(of).collect());
            };
            walk(dir.path(), 1, moving, times);
            let (mut warnings, options) = (Warnings::default(), OpenOptions::default());
            let found = Source::open(dir.path(), &options, None).unwrap().examine(&options);
            check_compensation(&found, dir.path(), &options, &mut warnings);
            let said: Vec<&str> = warnings.all().iter().map(|warning| warning.text.as_str()).collect();
            assert_eq!(said.is_empty(), moving, "{said:?}");
        }
    }
}
