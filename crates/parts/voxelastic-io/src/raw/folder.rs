//! The scans of a folder.

use super::timed_scan::TimedScan;
use crate::clouds::CloudFormat;
use crate::dumps;
use crate::folders::{CloudFolder, ScanTimes, find_clouds, has_extension, list, match_times, name_of, read_scan_times, scan_numbers, stem_of};
use crate::scan_list::{NODES_OF_SENSOR, read_scan, undistorted_sign_of};
use crate::stamped_cloud::{ASSUMED_PERIOD_S, Interval, SweepTime};
use crate::{Error, PointTimes, Result, SensorFolder, poses};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use voxelastic::event::NodeId;

/// A scan whose cloud has not been decoded.
#[derive(Clone, Debug)]
pub(super) struct RawScan {
    path: PathBuf,
    name: String,
    index: usize,
    pub(super) node: NodeId,
    /// Which sensor took it, if there are several.
    pub(super) sensor: u16,
    /// Seconds, if known from files or names.
    time: Option<f64>,
    sweep: Option<[f64; 2]>,
    /// How long a sweep takes.
    pub(super) sweeps: SweepTime,
}

impl RawScan {
    /// Seconds, if known from files or names.
    pub(super) fn time(&self) -> Option<f64> {
        self.time
    }

    /// What speaks for a cloud that is undistorted already, although its points have times.
    pub(super) fn undistorted_sign(&self) -> Option<String> {
        undistorted_sign_of(&self.path, self.index)
    }

    /// The cloud's file.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Decodes the cloud.
    ///
    /// # Errors
    /// As [`crate::clouds::read`].
    pub(super) fn read(&self) -> Result<TimedScan> {
        let mut decoded = read_scan(&self.path, self.index)?;
        decoded.cloud.sensor = self.sensor;
        // A cloud may have a time of its own.
        let time = self.time.or(decoded.stamp).unwrap_or(ASSUMED_PERIOD_S * self.index as f64);
        Ok(TimedScan {
            name: self.name.clone(),
            index: self.index,
            node: self.node,
            time,
            sweep: self.sweep,
            cloud: decoded.relative_to(time, self.sweeps),
            imu: Vec::new(),
        })
    }
}

/// The scans of further folders among those of the first, in the order of their times, with nodes of their own.
///
/// # Errors
/// [`Error::Dataset`] if scans of one have no times, and as [`read_folder`].
pub(super) fn read_further_folders(path: &Path, scans: &mut Vec<RawScan>, further: &[SensorFolder], times: PointTimes) -> Result<String> {
    let mut text = String::new();
    check_times(path, scans)?;
    for (sensor, SensorFolder { path, .. }) in (1u16..).zip(further) {
        let (others, described) = read_folder(path, times)?;
        check_times(path, &others)?;
        let _ = write!(text, "\nsensor {}: {}: {}", sensor + 1, path.display(), described.lines().collect::<Vec<_>>().join("; "));
        scans.extend(others.into_iter().map(|scan| RawScan {
            sensor,
            node: scan.node % NODES_OF_SENSOR + NodeId::from(sensor) * NODES_OF_SENSOR,
            ..scan
        }));
    }
    scans.sort_by(|a, b| a.time.unwrap_or(0.0).total_cmp(&b.time.unwrap_or(0.0)).then(a.sensor.cmp(&b.sensor)));
    Ok(text)
}

fn check_times(path: &Path, scans: &[RawScan]) -> Result<()> {
    if scans.iter().all(|scan| scan.time.is_some_and(f64::is_finite)) {
        return Ok(());
    }
    let problem = "scans without times: their order among those of the other sensor is not known";
    Err(Error::dataset(path, problem, "add times.txt, a time in seconds for each scan"))
}

/// The scans of a folder, and their description.
pub(super) fn read_folder(path: &Path, times: PointTimes) -> Result<(Vec<RawScan>, String)> {
    if CloudFormat::of(path) == Some(CloudFormat::E57) {
        let problem = "a file of laser scans, each from another position: not a sequence";
        return Err(Error::dataset(path, problem, "map it with the poses that it holds"));
    }
    match find_clouds(path) {
        Ok(folder) => of_clouds(path, folder, times),
        // Dumps keep each cloud in a folder of its own.
        Err(error) => of_dump(path)?.ok_or(error),
    }
}

fn of_clouds(path: &Path, folder: CloudFolder, point_times: PointTimes) -> Result<(Vec<RawScan>, String)> {
    let times = times(path, &folder)?;
    let mut text = format!("clouds: {} {}", folder.clouds.len(), folder.format);
    let location = &folder.relative;
    let _ = if location.as_os_str().is_empty() { write!(text, " in the folder") } else { write!(text, " in {}/", location.display()) };
    text.push_str("\ntimes: ");
    text.push_str(&times.described);
    folder.notes.iter().for_each(|note| text.push_str(&format!("\nnote: {note}")));
    let numbers = scan_numbers(&folder.clouds);
    let sweeps = SweepTime { interval_s: times.times.as_deref().and_then(Interval::of), is_stretched: point_times == PointTimes::OverInterval };
    let scan = |(index, cloud): (usize, &crate::folders::CloudFile)| RawScan {
        path: cloud.path.clone(),
        name: stem_of(&cloud.path),
        index,
        node: numbers.as_ref().map_or(index as NodeId, |n| n[index]),
        sensor: 0,
        time: times.times.as_ref().map(|t| t[index]),
        sweep: times.sweeps.as_ref().map(|s| s[index]),
        sweeps,
    };
    Ok((folder.clouds.iter().enumerate().map(scan).collect(), text))
}

/// The scans of a folder that a SLAM system left.
fn of_dump(path: &Path) -> Result<Option<(Vec<RawScan>, String)>> {
    let Some(dump) = dumps::find(path)? else { return Ok(None) };
    let scan = |entry: &crate::scan_list::ScanEntry| RawScan {
        path: entry.path.clone(),
        name: entry.path.strip_prefix(path).unwrap_or(&entry.path).with_extension("").display().to_string(),
        index: entry.index,
        node: entry.node,
        sensor: 0,
        time: Some(entry.time),
        sweep: None,
        sweeps: SweepTime::default(),
    };
    let scans: Vec<RawScan> = dump.scans.iter().map(scan).collect();
    let text = format!("clouds: {} of a {}\ntimes: of its keyframes", scans.len(), dump.system);
    Ok(Some((scans, text)))
}

/// Times of all scans, and where they come from.
struct Times {
    times: Option<Vec<f64>>,
    sweeps: Option<Vec<[f64; 2]>>,
    described: String,
}

/// Times from KITTI's timestamps, from the names, or from a file of times in the folder or next to the clouds.
fn times(path: &Path, folder: &CloudFolder) -> Result<Times> {
    let clouds_in = path.join(&folder.relative);
    if let Some(ScanTimes { file, times, sweeps }) = read_scan_times(&clouds_in, &folder.clouds)? {
        let described = if sweeps.is_some() { format!("{file}, with start and end of each sweep") } else { file };
        return Ok(Times { times: Some(times), sweeps, described });
    }
    if let Some(times) = folder.clouds.iter().map(|c| c.stamp).collect() {
        return Ok(Times { times: Some(times), sweeps: None, described: "in the clouds' names".into() });
    }
    let parent = clouds_in.parent().filter(|parent| parent.starts_with(path));
    for place in [Some(path), parent].into_iter().flatten() {
        let files = list(place)?;
        let is_times = |f: &&PathBuf| f.is_file() && has_extension(f, &["txt", "csv"]) && stem_of(f).eq_ignore_ascii_case("times");
        if let Some(file) = files.iter().find(is_times) {
            let times = match_times(&poses::read_times(file)?, &folder.clouds, file)?;
            return Ok(Times { times: Some(times), sweeps: None, described: name_of(file) });
        }
    }
    let described = format!("the clouds' own, else unknown: {ASSUMED_PERIOD_S} s between scans");
    Ok(Times { times: None, sweeps: None, described })
}
