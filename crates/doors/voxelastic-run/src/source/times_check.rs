//! Before mapping: what the times of points mean, and which reading of them holds where there are two.

use super::Source;
use super::sample::Sample;
use crate::Result;
use crate::input::Input;
use crate::warning::{Code, Warnings};
use std::path::Path;
use voxelastic_io::{OpenOptions, PointTimes, contradicts_interval};
use voxelastic_slam::{TimesTrial, TimesVerdict};

/// Scans of a trial at most, and those among them that tell something.
const SCANS: usize = 150;
const TELLING: usize = 40;
/// The readings that a trial compares.
const READINGS: [PointTimes; 3] = [PointTimes::Given, PointTimes::OverInterval, PointTimes::Undistorted];

/// A sweep that does not take as long as it takes until the next cloud comes.
#[derive(Clone, Copy, Debug)]
struct Misfit {
    sweep_s: f64,
    interval_s: f64,
}

impl Source {
    /// Opens data as [`open`](Self::open) does; where the times of points contradict the interval between clouds, under the reading of them that surfaces prefer, which is a warning. Also how
    /// it was opened then.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn open_decided(path: &Path, options: &OpenOptions, slam: Option<bool>, warnings: &mut Warnings) -> Result<(Self, OpenOptions)> {
        let source = Self::open(path, options, slam)?;
        let Some(point_times) = decide(&source.sample(1), path, options, warnings) else { return Ok((source, options.clone())) };
        let options = OpenOptions { point_times, ..options.clone() };
        Ok((Self::open(path, &options, slam)?, options))
    }
}

/// Says what the times of points mean, and returns another reading of them if surfaces are sharper under it.
pub(super) fn decide(sample: &Sample, path: &Path, options: &OpenOptions, warnings: &mut Warnings) -> Option<PointTimes> {
    let Some(sweep) = sample.sweep_s() else {
        if !sample.clouds.is_empty() {
            tracing::info!("points have no times: clouds are taken as they are, undistorted or not");
        }
        return None;
    };
    tracing::info!("points have times: a sweep takes {:.1} ms", sweep * 1e3);
    let misfit = misfit(sample)?;
    if options.point_times != PointTimes::Undecided {
        return None;
    }
    tracing::info!("{misfit}: looking at the surfaces of some scans");
    let verdict = trial(path, options, &[1.0, (misfit.interval_s / misfit.sweep_s) as f32, 0.0]);
    let shown = verdict.as_ref().map(shown).unwrap_or_default();
    match verdict.and_then(|verdict| verdict.best).map(|best| READINGS[best]) {
        Some(PointTimes::Given) => tracing::info!("they are right: {shown}"),
        Some(reading) => {
            let words = match reading {
                PointTimes::OverInterval => "so a sweep is taken to last until the next cloud comes",
                _ => "so clouds are taken to be undistorted already",
            };
            warnings.add(Code::TimesChanged, format!("{misfit}; {shown}, {words}"), "--point-times given takes the times as they are");
            return Some(reading);
        }
        None => {
            let why = if shown.is_empty() { "the scans do not tell which, as the sensor hardly moves in them".to_owned() } else { shown };
            let cause = if misfit.sweep_s > misfit.interval_s {
                "the times are in another unit, or of several sweeps"
            } else {
                "that is right if the sensor looks at a part of the circle, or clouds were left out; else the times are in another unit"
            };
            let remedy = "say which with --point-times given, over-interval or undistorted";
            warnings.add(Code::DoubtfulTimes, format!("{misfit}: {cause}; {why}"), remedy);
        }
    }
    None
}

/// Where nothing else is doubtful about the times of points: whether surfaces are sharper with clouds that are taken to be undistorted already. It takes as long as
/// the odometry of some hundred scans, so a run does not look.
pub fn check_undistorted(sample: &Sample, path: &Path, options: &OpenOptions, warnings: &mut Warnings) {
    if sample.sweep_s().is_none() || misfit(sample).is_some() || options.point_times != PointTimes::Undecided {
        return;
    }
    let Some(verdict) = trial(path, options, &[1.0, 0.0]) else { return };
    let [as_given, undistorted] = [0, 1].map(|k| verdict.spreads[k] * 100.0);
    let shown = format!("surfaces of {} scans are {as_given:.2} cm apart by the times of points, {undistorted:.2} cm without", verdict.scans);
    if verdict.best == Some(1) {
        let text = format!("clouds seem to be undistorted already, although their points have times: {shown}");
        warnings.add(Code::DoubtfulTimes, text, "map with --point-times undistorted");
    } else {
        tracing::info!("{shown}");
    }
}

fn misfit(sample: &Sample) -> Option<Misfit> {
    let (sweep_s, interval_s) = (sample.sweep_s()?, sample.interval_s?);
    contradicts_interval(sweep_s, interval_s).then_some(Misfit { sweep_s, interval_s })
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
    for scan in scans.filter(|scan| scan.cloud.sensor == 0).take(SCANS) {
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
        "surfaces of {} scans are {given:.2} cm apart if the times are right, {over:.2} cm if a sweep lasts until the next cloud comes, and {none:.2} cm if clouds are undistorted already",
        verdict.scans
    )
}

impl std::fmt::Display for Misfit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "a sweep takes {:.3} s by the times of its points, but clouds come every {:.3} s", self.sweep_s, self.interval_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::SampledCloud;
    use voxelastic_io::{SensorFolder, pcd};
    use voxelastic_sim::sensor::LidarSettings;
    use voxelastic_sim::{PoseSource, SimOptions, Simulation};

    #[test]
    fn sweeps_that_do_not_fill_the_interval_between_clouds_are_doubted() {
        let does_not_fit = |sweep_s: f64, interval_s: f64| {
            let cloud = SampledCloud { returns: 1000, range_m: 20.0, sweep_s: Some(sweep_s) };
            misfit(&Sample { clouds: vec![cloud; 5], interval_s: Some(interval_s), ..Sample::default() }).is_some()
        };
        for (sweep, interval) in [(0.1, 0.1), (0.098, 0.1), (0.05, 0.05), (0.1, 2.0), (0.07, 0.1)] {
            assert!(!does_not_fit(sweep, interval), "{sweep} of {interval}");
        }
        assert!(does_not_fit(0.2, 0.1) && does_not_fit(0.05, 0.1));
    }

    /// A walk whose sweeps have times, of which `spoil` makes what it has, begun `late` seconds.
    fn walk(dir: &Path, every: usize, moving: bool, late: f64, spoil: impl Fn(&mut voxelastic::Cloud)) {
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
        let mut times = String::new();
        for (k, scan) in walk.scans(PoseSource::Truth).step_by(every).enumerate() {
            let mut cloud = scan.cloud;
            spoil(&mut cloud);
            pcd::write(dir.join(format!("{k:06}.pcd")), &cloud).unwrap();
            times.push_str(&format!("{:.6}\n", 100.0 + scan.time + late));
        }
        std::fs::write(dir.join("times.txt"), times).unwrap();
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
            walk(dir.path(), every, name != "undistorted", 0.0, spoil);
            let mut warnings = Warnings::default();
            let options = OpenOptions::default();
            let found = Source::open(dir.path(), &options, None).unwrap().examine(&options);
            let reading = decide(&found.sample, dir.path(), &options, &mut warnings);
            let said: Vec<&str> = warnings.all().iter().map(|warning| warning.text.as_str()).collect();
            println!("{name}: {reading:?}, {said:?}");
            assert_eq!(reading, expected, "{name}: {said:?}");
            assert_eq!(said.is_empty(), expected.is_none(), "{name}: {said:?}");
        }
    }

    #[test]
    fn undistorted_clouds_that_still_have_times_are_told() {
        for moving in [true, false] {
            let dir = tempfile::tempdir().unwrap();
            let times = |cloud: &mut voxelastic::Cloud| {
                let of = |k: usize| 0.1 * (k % cloud.width) as f32 / cloud.width as f32;
                cloud.time = Some((0..cloud.len()).map(of).collect());
            };
            walk(dir.path(), 1, moving, 0.0, times);
            let (mut warnings, options) = (Warnings::default(), OpenOptions::default());
            let found = Source::open(dir.path(), &options, None).unwrap().examine(&options);
            check_undistorted(&found.sample, dir.path(), &options, &mut warnings);
            let said: Vec<&str> = warnings.all().iter().map(|warning| warning.text.as_str()).collect();
            assert_eq!(said.is_empty(), moving, "{said:?}");
        }
    }
    #[test]
    fn sweeps_are_compared_with_the_interval_of_their_own_sensor() {
        let dirs = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
        // The second sensor turns half a turn later.
        dirs.iter().zip([0.0, 0.05]).for_each(|(dir, late)| walk(dir.path(), 1, true, late, |_| ()));
        let further = SensorFolder { path: dirs[1].path().into(), t_base_lidar: Some(voxelastic::Pose::identity()) };
        let options = OpenOptions { more_folders: vec![further], t_base_lidar: Some(voxelastic::Pose::identity()), ..OpenOptions::default() };
        let sample = Source::open(dirs[0].path(), &options, None).unwrap().sample(1);
        assert!(misfit(&sample).is_none() && (sample.interval_s.unwrap() - 0.1).abs() < 1e-3, "{:?}", sample.interval_s);
    }
}
