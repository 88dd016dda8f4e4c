//! Opening scans without poses.

use super::folder::{RawScan, read_folder, read_further_folders};
use super::imu_feed::FolderImu;
use super::timed_scan::TimedScan;
use crate::bag::{self, RawRecording};
use crate::fingerprint::Fingerprint;
use crate::folders::holds_clouds;
use crate::read_ahead::{IdleStep, ReadAhead};
use crate::read_position::{Place, ReadPosition};
use crate::{Error, OpenOptions, Result, SensorFolder, imu_csv};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use voxelastic::event::NodeId;
use voxelastic::mapper::ScanSource;
use voxelastic::sensor::BeamModel;
use voxelastic::{Cloud, Pose};

/// Number of clouds that are decoded ahead.
const AHEAD: usize = 2;

/// Opens the scans of a folder, a recording or a capture without poses. Of the options, [`OpenOptions::use_imu`] applies, and to
/// recordings [`OpenOptions::cloud_topic`], [`OpenOptions::imu_topic`] and [`OpenOptions::metadata`]. Scans of several sensors ([`OpenOptions::more_sensors`] of a
/// recording, [`OpenOptions::more_folders`]) come as one list; where the sensors are on each other is said by [`OpenOptions::t_base_lidar`] and those beside
/// it, or by fixed transforms of the recording. Other options are not used.
///
/// # Errors
/// [`Error::Dataset`](crate::Error::Dataset) if there are no clouds, if several folders or formats could be meant, if where a further sensor is is not known, or if a
/// file of times does not fit the clouds; [`Error::Ambiguous`](crate::Error::Ambiguous) if a recording has several topics of clouds;
/// [`Error::Content`](crate::Error::Content) if a file of times is damaged; [`Error::Io`](crate::Error::Io).
pub fn open(path: impl AsRef<Path>, options: &OpenOptions) -> Result<RawScans> {
    let path = path.as_ref();
    let is_recording = if path.is_file() { bag::BagFormat::of(path)?.is_some() } else { !holds_clouds(path) && bag::is_recording(path)? };
    let (input, description, t_first_sensor) = if is_recording {
        if !options.more_folders.is_empty() {
            return Err(Error::dataset(path, "a recording, which has all of its sensors", "name the further sensor by its topic, not by a folder"));
        }
        let recording = RawRecording::open(path, options)?;
        let (description, t_first_sensor) = (recording.description(), recording.t_first_sensor().to_vec());
        (Input::Recording(Box::new(recording)), description, t_first_sensor)
    } else {
        let (mut scans, mut description) = read_folder(path, options.point_times)?;
        let t_first_sensor = mounts_of_folders(options)?;
        if !t_first_sensor.is_empty() {
            description.push_str(&read_further_folders(path, &mut scans, &options.more_folders, options.point_times)?);
        }
        let imu = if options.use_imu { FolderImu::find(path)? } else { None };
        if let Some(imu) = &imu {
            description.push_str(&format!("\nimu: {} samples in {}/{}", imu.len(), imu_csv::FOLDER, imu_csv::FILE));
        }
        (Input::Folder(scans.into(), imu), description, t_first_sensor)
    };
    Ok(RawScans { path: path.into(), description, input, t_first_sensor })
}

/// Where the sensors of further folders are in the frame of the first.
fn mounts_of_folders(options: &OpenOptions) -> Result<Vec<Pose>> {
    let of_folder = |folder: &SensorFolder| {
        let known = options.t_base_lidar.zip(folder.t_base_lidar).map(|(first, further)| first.inv_mul(&further));
        let remedy = "say where the sensors are: one --t-base-lidar for each folder, in their order";
        known.ok_or_else(|| {
            Error::dataset(&folder.path, "where its sensor is beside the first is not known, and there are no poses that say it", remedy)
        })
    };
    options.more_folders.iter().map(of_folder).collect()
}

/// Scans without poses. No cloud has been decoded.
#[derive(Clone, Debug)]
pub struct RawScans {
    path: PathBuf,
    description: String,
    input: Input,
    t_first_sensor: Vec<Pose>,
}

#[derive(Clone, Debug)]
enum Input {
    Folder(Arc<[RawScan]>, Option<FolderImu>),
    Recording(Box<RawRecording>),
}

impl RawScans {
    /// The path that was opened.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What was found, in a few lines; to be shown to the user.
    pub fn description(&self) -> &str {
        &self.description
    }

    /// Pose of each further sensor in the frame of the first, in the order of [`Cloud::sensor`] from 1 on; empty for one sensor.
    pub fn t_first_sensor(&self) -> &[Pose] {
        &self.t_first_sensor
    }

    /// Whether the scans come from a recording, and not from a folder of clouds.
    pub fn is_recording(&self) -> bool {
        matches!(self.input, Input::Recording(_))
    }

    /// Number of scans, if it is known before they are read.
    pub fn count(&self) -> Option<usize> {
        match &self.input {
            Input::Folder(scans, _) => Some(scans.len()),
            Input::Recording(recording) => recording.count(),
        }
    }

    /// The usual time between the clouds of the first sensor, seconds, if it is known and a sweep can take that long.
    pub fn interval_s(&self) -> Option<f64> {
        match &self.input {
            Input::Folder(scans, _) => scans.iter().find(|scan| scan.sensor == 0).and_then(|scan| scan.sweeps.interval_s),
            Input::Recording(recording) => recording.interval_s(),
        }
    }

    /// What speaks for clouds that are undistorted already, although their points have times. Of a folder, the first cloud is read.
    pub fn undistorted_sign(&self) -> Option<String> {
        match &self.input {
            Input::Folder(scans, _) => scans.first().and_then(RawScan::undistorted_sign),
            Input::Recording(recording) => recording.undistorted_sign(),
        }
    }

    /// The longest time between two neighbouring scans of a folder, seconds, if their times are known before they are read.
    pub fn longest_pause_s(&self) -> Option<f64> {
        let Input::Folder(scans, _) = &self.input else { return None };
        let times: Option<Vec<f64>> = scans.iter().map(RawScan::time).collect();
        times?.windows(2).map(|pair| pair[1] - pair[0]).max_by(f64::total_cmp)
    }

    /// The sensor's own tables of beams, if the data contain them: those of an Ouster's packets.
    pub fn sensor(&self) -> Option<BeamModel> {
        match &self.input {
            Input::Folder(..) => None,
            Input::Recording(recording) => recording.sensor(),
        }
    }

    /// The scans in the order of time, decoded ahead. A cloud that cannot be read is an `Err` item, and the iteration continues with the
    /// next.
    pub fn iter(&self) -> TimedScans {
        self.iter_after(0, 0)
    }

    /// The scans from a position on, of the same data. Those of a recording are read from its beginning, and the first
    /// [`items_to_skip`](ReadPosition::items_to_skip) are to be dropped by the caller.
    pub fn iter_from(&self, position: &ReadPosition) -> TimedScans {
        if let Place::RawFolder { scans, samples } = position.0 { self.iter_after(scans, samples) } else { self.iter() }
    }

    /// A number that differs, as a rule, for other data: other scans, or files that were changed since.
    pub fn fingerprint(&self) -> u64 {
        let mut print = Fingerprint::default();
        match &self.input {
            Input::Folder(scans, imu) => {
                scans.iter().for_each(|scan| print.file(scan.path()));
                print.numbers([imu.as_ref().map_or(0, |imu| imu.len() as u64)]);
            }
            Input::Recording(_) => print.file(&self.path),
        }
        self.t_first_sensor.iter().for_each(|pose| print.pose(pose));
        print.digest()
    }

    /// The scans of a folder after so many, and after so many samples; of a recording all.
    fn iter_after(&self, taken: usize, samples: usize) -> TimedScans {
        let is_folder = matches!(self.input, Input::Folder(..));
        let scans: Box<dyn Iterator<Item = Result<TimedScan>> + Send> = match &self.input {
            Input::Folder(scans, imu) => {
                let (scans, imu) = (Arc::clone(scans), imu.clone());
                let mut given = samples;
                Box::new((taken.min(scans.len())..scans.len()).map(move |k| {
                    let mut scan = scans[k].read()?;
                    if let Some(imu) = &imu {
                        scan.imu = imu.until(given, &scan.cloud, scan.time).to_vec();
                        given += scan.imu.len();
                    }
                    Ok(scan)
                }))
            }
            Input::Recording(recording) => Box::new(recording.scans().map(|scan| {
                scan.map(|scan| TimedScan {
                    name: scan.index.to_string(),
                    index: scan.index,
                    node: scan.node,
                    time: scan.time,
                    sweep: None,
                    cloud: scan.cloud,
                    imu: scan.imu,
                })
            })),
        };
        let scans = ReadAhead::new("voxelastic-decode", AHEAD, scans, |what| Err(Error::Panicked { what }));
        TimedScans { scans, is_folder, taken, samples }
    }

    /// Reads clouds again by their nodes. Those of a recording must have been delivered by [`iter`](Self::iter).
    pub fn clouds(&self) -> Box<dyn ScanSource + Send> {
        match &self.input {
            Input::Folder(scans, _) => {
                let indices = scans.iter().enumerate().map(|(k, scan)| (scan.node, k)).collect();
                Box::new(FolderClouds { scans: Arc::clone(scans), indices })
            }
            Input::Recording(recording) => Box::new(recording.clouds()),
        }
    }
}

impl IntoIterator for &RawScans {
    type Item = Result<TimedScan>;
    type IntoIter = TimedScans;

    fn into_iter(self) -> TimedScans {
        self.iter()
    }
}

/// Iterator over [`RawScans`].
#[derive(Debug)]
pub struct TimedScans {
    scans: ReadAhead<Result<TimedScan>>,
    is_folder: bool,
    /// Scans, and samples of an inertial unit, that were taken.
    taken: usize,
    samples: usize,
}

impl TimedScans {
    /// A function that decodes one scan ahead in the time of the calling thread, see [`IdleStep`].
    pub fn idle_step(&mut self) -> IdleStep {
        self.scans.idle_step()
    }

    /// Where it is.
    pub fn read_position(&self) -> ReadPosition {
        let Self { taken, samples, .. } = *self;
        ReadPosition(if self.is_folder { Place::RawFolder { scans: taken, samples } } else { Place::Recording { items: taken } })
    }
}

impl Iterator for TimedScans {
    type Item = Result<TimedScan>;

    fn next(&mut self) -> Option<Result<TimedScan>> {
        let scan = self.scans.next()?;
        self.taken += 1;
        self.samples += scan.as_ref().map_or(0, |scan| scan.imu.len());
        Some(scan)
    }
}

/// Reads the clouds of a folder again.
struct FolderClouds {
    scans: Arc<[RawScan]>,
    /// Index of each node's scan.
    indices: HashMap<NodeId, usize>,
}

impl ScanSource for FolderClouds {
    fn cloud(&mut self, node: NodeId) -> std::result::Result<Cloud, Box<dyn std::error::Error + Send + Sync>> {
        let index = self.indices.get(&node).ok_or("no scan of the data belongs to it")?;
        Ok(self.scans[*index].read()?.cloud)
    }
}
