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
/// Readings that a trial compares, with what they multiply times by.
const GIVEN_OR_NOT: [(PointTimes, f32); 2] = [(PointTimes::Given, 1.0), (PointTimes::Undistorted, 0.0)];

/// Scans that come after longer are of another drive, unless a clock was set, seconds.
const LONGEST_PAUSE_S: f64 = 600.0;
/// How to take times of points as they are.
const GIVEN: &str = "--point-times given takes the times as they are";

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
    tell_pause(sample, warnings);
    let Some(sweep) = sample.sweep_s() else {
        if !sample.clouds.is_empty() {
            tracing::info!("points have no times: clouds are taken as they are, undistorted or not");
        }
        return None;
    };
    tracing::info!("points have times: a sweep takes {:.1} ms", sweep * 1e3);
    let is_undecided = options.point_times == PointTimes::Undecided;
    if let Some(misfit) = misfit(sample) {
        return if is_undecided { of_misfit(misfit, path, options, warnings) } else { None };
    }
    if sample.lacks_motion() && options.point_times != PointTimes::Undistorted {
        return without_motion(sample, path, options, warnings);
    }
    sample.undistorted_sign.as_ref().filter(|_| is_undecided).and_then(|sign| of_sign(sign, path, options, warnings))
}

/// Says that scans are of several drives.
fn tell_pause(sample: &Sample, warnings: &mut Warnings) {
    if let Some(pause) = sample.longest_pause_s.filter(|pause| *pause > LONGEST_PAUSE_S) {
        let text = format!("between two scans there are {}: they are of several drives, or the clock was set", duration(pause));
        warnings.add(Code::Gap, text, "make a folder of each drive, and map the second with --into the map of the first");
    }
}

/// A time of minutes or more, in words.
fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 7200.0 => format!("{:.0} minutes", s / 60.0),
        s if s < 172_800.0 => format!("{:.0} hours", s / 3600.0),
        s => format!("{:.0} days", s / 86_400.0),
    }
}

/// Decides between the readings of times that contradict the interval between clouds.
fn of_misfit(misfit: Misfit, path: &Path, options: &OpenOptions, warnings: &mut Warnings) -> Option<PointTimes> {
    tracing::info!("{misfit}: looking at the surfaces of some scans");
    let stretched = (misfit.interval_s / misfit.sweep_s) as f32;
    let Trial { best, shown } =
        trial(path, options, &[(PointTimes::Given, 1.0), (PointTimes::OverInterval, stretched), (PointTimes::Undistorted, 0.0)]);
    match best {
        Some(PointTimes::Given) => tracing::info!("they are right: {shown}"),
        Some(reading) => {
            let words = match reading {
                PointTimes::OverInterval => "so a sweep is taken to last until the next cloud comes",
                _ => "so clouds are taken to be undistorted already",
            };
            warnings.add(Code::TimesChanged, format!("{misfit}; {shown}, {words}"), GIVEN);
            return Some(reading);
        }
        None => {
            let cause = if misfit.sweep_s > misfit.interval_s {
                "the times are in another unit, or of several sweeps"
            } else {
                "that is right if the sensor looks at a part of the circle, or clouds were left out; else the times are in another unit"
            };
            let remedy = "say which with --point-times given, over-interval or undistorted";
            warnings.add(Code::DoubtfulTimes, format!("{misfit}: {cause}; {shown}"), remedy);
        }
    }
    None
}

/// Decides where poses do not say how the lidar moved during sweeps whose points have times.
fn without_motion(sample: &Sample, path: &Path, options: &OpenOptions, warnings: &mut Warnings) -> Option<PointTimes> {
    let (cause, remedy) = if sample.has_times {
        (
            "points have times, but poses are too far apart in time to say how the lidar moved during a sweep",
            "name poses of each sweep, such as those of the odometry, or let --slam estimate them; right with --point-times undistorted if clouds are undistorted already",
        )
    } else {
        (
            "points have times, but neither clouds nor poses do, so that nothing says how the lidar moved during a sweep",
            "write the time of each cloud to times.txt, or say --point-times over-interval where one sweep follows the other, or undistorted",
        )
    };
    if options.point_times != PointTimes::Undecided {
        warnings.add(Code::DoubtfulTimes, format!("{cause}: clouds are mapped as they are, distorted or not"), remedy);
        return None;
    }
    let Trial { best, shown } = trial(path, options, &GIVEN_OR_NOT);
    match best {
        Some(PointTimes::Undistorted) => {
            tracing::info!("{cause}: clouds are undistorted already, as {shown}");
            None
        }
        Some(_) if !sample.has_times => {
            let text = format!("{cause}; {shown}, so clouds are taken to be those of one sweep after the other");
            warnings.add(Code::TimesChanged, text, "write the time of each cloud to times.txt; --point-times undistorted takes clouds as they are");
            Some(PointTimes::OverInterval)
        }
        Some(_) => {
            warnings.add(Code::DoubtfulTimes, format!("{cause}: clouds are mapped distorted, as {shown}"), remedy);
            None
        }
        None => {
            warnings.add(Code::DoubtfulTimes, format!("{cause}: clouds are mapped as they are, distorted or not; {shown}"), remedy);
            None
        }
    }
}

/// Decides where something speaks for clouds that are undistorted already.
fn of_sign(sign: &str, path: &Path, options: &OpenOptions, warnings: &mut Warnings) -> Option<PointTimes> {
    let Trial { best, shown } = trial(path, options, &GIVEN_OR_NOT);
    if best == Some(PointTimes::Given) {
        tracing::info!("{sign}, but clouds are not undistorted: {shown}");
        return None;
    }
    warnings.add(Code::TimesChanged, format!("{sign}, so clouds are taken to be undistorted already; {shown}"), GIVEN);
    Some(PointTimes::Undistorted)
}

/// Where nothing else is doubtful about the times of points: whether surfaces are sharper with clouds that are taken to be undistorted already. It takes as long as
/// the odometry of some hundred scans, so a run does not look.
pub fn check_undistorted(sample: &Sample, path: &Path, options: &OpenOptions, warnings: &mut Warnings) {
    let is_decided = misfit(sample).is_some() || sample.lacks_motion() || sample.undistorted_sign.is_some();
    if sample.sweep_s().is_none() || is_decided || options.point_times != PointTimes::Undecided {
        return;
    }
    let Trial { best, shown } = trial(path, options, &GIVEN_OR_NOT);
    if best == Some(PointTimes::Undistorted) {
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

/// What a trial of several readings has shown.
struct Trial {
    /// The reading under which surfaces are sharper than under each of the others.
    best: Option<PointTimes>,
    /// How sharp they are, in words.
    shown: String,
}

/// Registers some scans under each reading, which multiplies times by a factor; 0: clouds are undistorted already.
fn trial(path: &Path, options: &OpenOptions, readings: &[(PointTimes, f32)]) -> Trial {
    let options = OpenOptions {
        cloud_topic: options.cloud_topic.clone(),
        metadata: options.metadata.clone(),
        point_times: PointTimes::Given,
        use_imu: false,
        ..OpenOptions::default()
    };
    let factors: Vec<f32> = readings.iter().map(|(_, factor)| *factor).collect();
    let mut trial = TimesTrial::new(&factors);
    let source = Source::open(path, &options, Some(true));
    let scans = source.iter().flat_map(Source::inputs).filter_map(|input| if let Input::RawScan(scan, _) = input { Some(scan) } else { None });
    for scan in scans.filter(|scan| scan.cloud.sensor == 0).take(SCANS) {
        trial.add(&scan.cloud, scan.time);
        if trial.scans() >= TELLING {
            break;
        }
    }
    let TimesVerdict { scans, spreads, best } = trial.verdict();
    if scans == 0 {
        return Trial { best: None, shown: "the scans do not tell: the sensor hardly moves in them, or they are few".to_owned() };
    }
    let words = |reading: PointTimes| match reading {
        PointTimes::OverInterval => "if a sweep lasts until the next cloud comes",
        PointTimes::Undistorted => "if clouds are undistorted already",
        _ => "if the times are right",
    };
    let parts: Vec<String> =
        readings.iter().zip(spreads).map(|((reading, _), spread)| format!("{:.2} cm {}", spread * 100.0, words(*reading))).collect();
    Trial { best: best.map(|best| readings[best].0), shown: format!("surfaces of {scans} scans are apart by {}", parts.join(", ")) }
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
            let cloud = SampledCloud { returns: 1000, range_m: 20.0, sweep_s: Some(sweep_s), has_motion: true };
            misfit(&Sample { clouds: vec![cloud; 5], interval_s: Some(interval_s), ..Sample::default() }).is_some()
        };
        for (sweep, interval) in [(0.1, 0.1), (0.098, 0.1), (0.05, 0.05), (0.1, 2.0), (0.07, 0.1)] {
            assert!(!does_not_fit(sweep, interval), "{sweep} of {interval}");
        }
        assert!(does_not_fit(0.2, 0.1) && does_not_fit(0.05, 0.1));
    }

    /// A walk whose sweeps have times, of which `spoil` makes what it has, begun `late` seconds. Returns its poses.
    fn walk(dir: &Path, every: usize, moving: bool, late: f64, spoil: impl Fn(&mut voxelastic::Cloud)) -> Vec<voxelastic::Pose> {
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
        let (mut times, mut poses) = (String::new(), Vec::new());
        for (k, scan) in walk.scans(PoseSource::Truth).step_by(every).enumerate() {
            let mut cloud = scan.cloud;
            spoil(&mut cloud);
            pcd::write(dir.join(format!("{k:06}.pcd")), &cloud).unwrap();
            times.push_str(&format!("{:.6}\n", 100.0 + scan.time + late));
            poses.push(scan.t_map_lidar);
        }
        std::fs::write(dir.join("times.txt"), times).unwrap();
        poses
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
    fn where_nothing_says_how_the_lidar_moved_during_a_sweep_it_is_told() {
        let undistorted = |cloud: &mut voxelastic::Cloud| {
            let of = |k: usize| 0.1 * (k % cloud.width) as f32 / cloud.width as f32;
            cloud.time = Some((0..cloud.len()).map(of).collect());
        };
        for (moving, point_times, expected, is_said) in [
            (true, PointTimes::Undecided, Some(PointTimes::OverInterval), true),
            (false, PointTimes::Undecided, None, false),
            (true, PointTimes::Given, None, true),
            (true, PointTimes::Undistorted, None, false),
        ] {
            let dir = tempfile::tempdir().unwrap();
            let poses = walk(dir.path(), 1, moving, 0.0, |cloud| {
                if !moving {
                    undistorted(cloud)
                }
            });
            std::fs::remove_file(dir.path().join("times.txt")).unwrap();
            let row = |pose: &voxelastic::Pose| {
                pose.to_homogeneous().fixed_rows::<3>(0).transpose().iter().map(f64::to_string).collect::<Vec<_>>().join(" ")
            };
            std::fs::write(dir.path().join("poses.txt"), poses.iter().map(|pose| row(pose) + "\n").collect::<String>()).unwrap();
            let options = OpenOptions { point_times, ..OpenOptions::default() };
            let open = |options: &OpenOptions| Source::open(dir.path(), options, Some(false)).unwrap().sample(1);
            let mut warnings = Warnings::default();
            let reading = decide(&open(&options), dir.path(), &options, &mut warnings);
            let said: Vec<&str> = warnings.all().iter().map(|warning| warning.text.as_str()).collect();
            assert_eq!((reading, !said.is_empty()), (expected, is_said), "{moving}, {point_times:?}: {said:?}");
            if let Some(point_times) = reading {
                assert!(!open(&OpenOptions { point_times, ..OpenOptions::default() }).lacks_motion());
            }
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
        dirs.iter().zip([0.0, 0.05]).for_each(|(dir, late)| drop(walk(dir.path(), 1, true, late, |_| ())));
        let further = SensorFolder { path: dirs[1].path().into(), t_base_lidar: Some(voxelastic::Pose::identity()) };
        let options = OpenOptions { more_folders: vec![further], t_base_lidar: Some(voxelastic::Pose::identity()), ..OpenOptions::default() };
        let sample = Source::open(dirs[0].path(), &options, None).unwrap().sample(1);
        assert!(misfit(&sample).is_none() && (sample.interval_s.unwrap() - 0.1).abs() < 1e-3, "{:?}", sample.interval_s);
    }
}
