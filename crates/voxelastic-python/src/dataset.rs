//! Scans and poses of folders and recordings, as events.

use crate::{arrays, errors, job};
use numpy::{PyArray1, PyArray2, PyReadonlyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::types::PyTuple;
use pyo3::{Bound, IntoPyObject, Py, PyAny, PyResult, Python, pyclass, pymethods};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use voxelastic::Pose;
use voxelastic::event::{Edge, Event, NodeId, Scan as CoreScan};
use voxelastic::mapper::IdleTask;
use voxelastic::motion::ImuSample;
use voxelastic::sensor::BeamModel;
use voxelastic_io::bag::KEYFRAME_DISTANCE_M;
use voxelastic_io::raw::{self, RawScans, TimedScans};
use voxelastic_io::source::{self, Events as SourceEvents, Source};
use voxelastic_io::{Error, Keyframing, OpenOptions, PoseKind, SensorFolder, SensorTopic};
use voxelastic_slam::slam::RawScan;

/// A folder or a recording.
#[pyclass(frozen, module = "voxelastic._native")]
pub struct Dataset {
    data: Arc<Mutex<Data>>,
}

/// What was opened.
enum Data {
    /// Scans with poses.
    Registered(Source),
    /// Scans without, and which of them are to be mapped.
    Raw(Box<RawScans>, Keyframing),
}

impl Data {
    /// Opens scans with poses; without, if `slam` says so, or there are none and `slam` does not say no.
    fn open(path: PathBuf, options: &OpenOptions, slam: Option<bool>) -> voxelastic_io::Result<Self> {
        let raw = || -> voxelastic_io::Result<Self> {
            let scans = raw::open(&path, options)?;
            let usual = if scans.is_recording() { Keyframing::Metres(KEYFRAME_DISTANCE_M) } else { Keyframing::All };
            Ok(Self::Raw(Box::new(scans), options.keyframing.unwrap_or(usual)))
        };
        if slam == Some(true) {
            return raw();
        }
        let is_one_sensor = options.more_sensors.is_empty() && options.more_folders.is_empty();
        match source::open(&path, options) {
            Err(Error::NoPoses { .. }) if is_one_sensor && slam.is_none() && options.poses.is_none() && options.graph.is_none() => raw(),
            opened => Ok(Self::Registered(opened?)),
        }
    }
}

/// An iterator over the events of a data set.
#[pyclass(frozen, module = "voxelastic._native")]
pub struct Events {
    events: Arc<Mutex<DataEvents>>,
}

/// An iterator over events or scans without poses.
pub enum DataEvents {
    /// The events of scans with poses.
    Registered(SourceEvents),
    /// Scans without.
    Raw(TimedScans, Keyframing),
}

/// Something that a mapper takes.
pub enum Input {
    /// An event.
    Event(Event),
    /// A scan without pose, and which of such scans are to be mapped.
    Raw(RawScan, Keyframing),
}

impl DataEvents {
    /// Work for threads that would be idle: decoding the next scans.
    pub fn idle_task(&mut self) -> IdleTask {
        match self {
            Self::Registered(events) => IdleTask::new(events.idle_step()),
            Self::Raw(scans, _) => IdleTask::new(scans.idle_step()),
        }
    }
}

impl Iterator for DataEvents {
    type Item = voxelastic_io::Result<Input>;

    fn next(&mut self) -> Option<Self::Item> {
        match self {
            Self::Registered(events) => events.next().map(|event| event.map(Input::Event)),
            Self::Raw(scans, keyframing) => {
                let raw =
                    |scan: raw::TimedScan| Input::Raw(RawScan { node: scan.node, time: scan.time, cloud: scan.cloud, imu: scan.imu }, *keyframing);
                scans.next().map(|scan| scan.map(raw))
            }
        }
    }
}

/// A scan of a data set or a simulation.
#[pyclass(frozen, module = "voxelastic._native")]
pub struct Scan {
    scan: Arc<CoreScan>,
    /// Which scans are to be mapped, and the samples of an inertial measurement unit, if they have no poses.
    raw: Option<(Keyframing, Vec<ImuSample>)>,
}

/// An event: its kind, and a scan, or two nodes with a 4 x 4 matrix, or a list of nodes with such matrices, or what is wrong with a scan.
pub type Item<'py> = (&'static str, Bound<'py, PyAny>);

#[pymethods]
impl Dataset {
    /// Opens a folder or a recording. Clouds are read when their turn comes.
    #[staticmethod]
    #[expect(clippy::too_many_arguments, reason = "called by name from Python only")]
    fn open(
        py: Python<'_>,
        path: PathBuf,
        poses: Option<PathBuf>,
        odometry: bool,
        graph: Option<PathBuf>,
        t_base_lidar: Vec<PyReadonlyArray1<'_, f64>>,
        every: Option<String>,
        cloud_topics: Vec<String>,
        more_folders: Vec<PathBuf>,
        pose_topic: Option<String>,
        metadata: Option<PathBuf>,
        deskew: bool,
        time_tolerance: f64,
        strict: bool,
        slam: Option<bool>,
    ) -> PyResult<Self> {
        let lidars = t_base_lidar.iter().map(arrays::pose).collect::<PyResult<Vec<_>>>()?;
        let further = |(k, topic): (usize, &String)| SensorTopic { topic: topic.clone(), t_base_lidar: lidars.get(k).copied() };
        let options = OpenOptions {
            poses,
            pose_kind: if odometry { PoseKind::Odometry } else { PoseKind::Optimised },
            graph,
            t_base_lidar: lidars.first().copied(),
            strict,
            keyframing: every.map(|text| text.parse()).transpose().map_err(|e: String| PyValueError::new_err(format!("every: {e}")))?,
            cloud_topic: cloud_topics.first().cloned(),
            more_folders: (1..).zip(more_folders).map(|(k, path)| SensorFolder { path, t_base_lidar: lidars.get(k).copied() }).collect(),
            more_sensors: cloud_topics.iter().enumerate().skip(1).map(further).collect(),
            pose_topic,
            metadata,
            deskew,
            time_tolerance_s: time_tolerance,
            ..OpenOptions::default()
        };
        let opened = job::run(py, move || Data::open(path, &options, slam))?;
        Ok(Self { data: Arc::new(Mutex::new(opened.map_err(|e| errors::file(py, &e))?)) })
    }

    /// What was found, in a few lines.
    fn description(&self, py: Python<'_>) -> String {
        self.with(py, |data| match data {
            Data::Registered(source) => source.description(),
            Data::Raw(scans, keyframing) => format!("{}\nscans taken: {keyframing}\nposes: none; a mapper estimates them", scans.description()),
        })
    }

    /// Number of scans, if it is known before they are read.
    fn scans(&self, py: Python<'_>) -> Option<usize> {
        self.with(py, |data| match data {
            Data::Registered(source) => source.scans(),
            Data::Raw(scans, _) => scans.count(),
        })
    }

    /// Whether the scans have poses.
    fn has_poses(&self, py: Python<'_>) -> bool {
        self.with(py, |data| matches!(data, Data::Registered(_)))
    }

    /// The events from the beginning.
    fn events(&self, py: Python<'_>) -> Events {
        let events = self.with(py, |data| match data {
            Data::Registered(source) => DataEvents::Registered(source.events()),
            Data::Raw(scans, keyframing) => DataEvents::Raw(scans.iter(), *keyframing),
        });
        Events { events: Arc::new(Mutex::new(events)) }
    }
}

impl Dataset {
    /// The sensor's own tables of beams, if the data contain them.
    pub fn sensor(&self, py: Python<'_>) -> Option<BeamModel> {
        self.with(py, |data| match data {
            Data::Registered(source) => source.sensor(),
            Data::Raw(scans, _) => scans.sensor(),
        })
    }

    /// Does `work` with the data, without the interpreter lock.
    fn with<R: Send>(&self, py: Python<'_>, work: impl FnOnce(&Data) -> R + Send) -> R {
        py.detach(|| work(&self.data.lock().unwrap_or_else(PoisonError::into_inner)))
    }
}

#[pymethods]
impl Events {
    /// The next event; none at the end.
    fn next<'py>(&self, py: Python<'py>) -> PyResult<Option<Item<'py>>> {
        let events = Arc::clone(&self.events);
        let event = job::run_short(py, || events.lock().unwrap_or_else(PoisonError::into_inner).next())?;
        let found = event.map(|event| match event {
            Ok(Input::Raw(RawScan { node, time, cloud, imu }, keyframing)) => {
                let scan = Scan { scan: Arc::new(CoreScan { node, time, t_map_lidar: Pose::identity(), cloud }), raw: Some((keyframing, imu)) };
                Ok(("scan", Py::new(py, scan)?.into_bound(py).into_any()))
            }
            Ok(Input::Event(event)) => item(py, Ok(event)),
            Err(error) => item(py, Err(error)),
        });
        found.transpose()
    }
}

impl Events {
    /// The iterator, to be read ahead.
    pub fn shared(&self) -> Arc<Mutex<DataEvents>> {
        Arc::clone(&self.events)
    }
}

/// An event for Python.
pub fn item<'py>(py: Python<'py>, event: voxelastic_io::Result<Event>) -> PyResult<Item<'py>> {
    let edge = |kind, edge: Edge| {
        let information = edge.information.map(Vec::from);
        let pose = &edge.t_from_to;
        Ok((kind, (edge.from, edge.to, arrays::matrix_of_pose(pose), arrays::numbers_of_pose(pose), information).into_pyobject(py)?.into_any()))
    };
    match event {
        Ok(Event::Scan(scan)) => Ok(("scan", Py::new(py, Scan::with_pose(scan))?.into_bound(py).into_any())),
        Ok(Event::OdometryEdge(e)) => edge("odometry", e),
        Ok(Event::LoopEdge(e)) => edge("loop", e),
        Ok(Event::PoseUpdate(poses)) => {
            let row = |(node, pose): &(NodeId, Pose)| (*node, arrays::matrix_of_pose(pose), arrays::numbers_of_pose(pose));
            let poses: Vec<_> = poses.iter().map(row).collect();
            Ok(("poses", poses.into_pyobject(py)?.into_any()))
        }
        Ok(_) => Err(errors::bug(&"an event of an unknown kind")),
        Err(error) => Ok(("problem", errors::file(py, &error).into_value(py).into_bound(py).into_any())),
    }
}

#[pymethods]
impl Scan {
    /// Its node, time stamp in seconds, and pose as a 4 x 4 matrix, if it has one.
    fn stamp(&self) -> (NodeId, f64, Option<[[f64; 4]; 4]>) {
        (self.scan.node, self.scan.time, self.raw.is_none().then(|| arrays::matrix_of_pose(&self.scan.t_map_lidar)))
    }

    /// Number of rows and columns of the cloud; one row if it is not organised.
    fn shape(&self) -> (usize, usize) {
        (self.scan.cloud.height, self.scan.cloud.width)
    }

    /// The points, N x 3, in the lidar frame.
    fn points<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        arrays::from_rows(py, self.scan.cloud.points.clone())
    }

    /// Intensities, colours, rings and times of the points, where there are any.
    fn channels<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let cloud = &self.scan.cloud;
        let colours = cloud.colours.clone().map(|colours| arrays::from_rows(py, colours)).transpose()?;
        let channels = (
            cloud.intensity.clone().map(|values| PyArray1::from_vec(py, values)),
            colours,
            cloud.ring.clone().map(|values| PyArray1::from_vec(py, values)),
            cloud.time.clone().map(|values| PyArray1::from_vec(py, values)),
        );
        channels.into_pyobject(py)
    }

    /// The same scan, corrected for the motion during the sweep; none if the motion or the times of the points are unknown.
    fn undistorted(&self, py: Python<'_>) -> Option<Self> {
        let CoreScan { node, time, t_map_lidar, cloud } = &*self.scan;
        let cloud = py.detach(|| cloud.undistorted())?;
        Some(Self { scan: Arc::new(CoreScan { node: *node, time: *time, t_map_lidar: *t_map_lidar, cloud }), raw: self.raw.clone() })
    }
}

impl Scan {
    /// A scan that has a pose.
    pub fn with_pose(scan: CoreScan) -> Self {
        Self { scan: Arc::new(scan), raw: None }
    }

    /// The scan for a mapper.
    pub fn input(&self) -> Input {
        let scan = (*self.scan).clone();
        match &self.raw {
            None => Input::Event(Event::Scan(scan)),
            Some((keyframing, imu)) => Input::Raw(RawScan { node: scan.node, time: scan.time, cloud: scan.cloud, imu: imu.clone() }, *keyframing),
        }
    }
}
