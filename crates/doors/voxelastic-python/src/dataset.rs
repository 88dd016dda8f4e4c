//! Scans and poses of folders and recordings, as events.

use crate::arrays::Channels;
use crate::{arrays, errors, job};
use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::types::PyTuple;
use pyo3::{Bound, IntoPyObject, Py, PyAny, PyResult, Python, pyclass, pymethods};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use voxelastic::Pose;
use voxelastic::event::{Edge, Event, NodeId, Scan as CoreScan};
use voxelastic::motion::ImuSample;
use voxelastic::sensor::BeamModel;
use voxelastic_io::{OpenOptions, PointTimes, PoseKind, SensorFolder, SensorTopic};
use voxelastic_run::poses::OdometrySetup;
use voxelastic_run::precision::{LARGEST_VEHICLE, near};
use voxelastic_run::{Input, Inputs, Source, Warnings};
use voxelastic_slam::slam::RawScan;

/// A folder or a recording.
#[pyclass(frozen, module = "voxelastic._native")]
pub struct Dataset {
    source: Arc<Mutex<Source>>,
}

/// An iterator over the events of a data set.
#[pyclass(frozen, module = "voxelastic._native")]
pub struct Events {
    inputs: Arc<Mutex<Inputs>>,
    /// How its scans are registered, if they have no poses.
    setup: Option<Arc<OdometrySetup>>,
}

/// A scan of a data set or a simulation, or one made of arrays.
#[pyclass(frozen, module = "voxelastic._native")]
pub struct Scan {
    scan: Arc<CoreScan>,
    /// If it has no pose.
    raw: Option<Raw>,
}

/// What a scan without a pose comes with.
#[derive(Clone, Default)]
struct Raw {
    /// How it is to be registered; none where the data do not say.
    setup: Option<Arc<OdometrySetup>>,
    /// Samples of an inertial measurement unit.
    imu: Vec<ImuSample>,
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
        point_times: &str,
        time_tolerance: f64,
        strict: bool,
        slam: Option<bool>,
        pose_change: &str,
        poses_check: &str,
    ) -> PyResult<(Self, Vec<(String, String)>)> {
        let poses_check = poses_check.parse().map_err(|e: String| PyValueError::new_err(format!("poses_check: {e}")))?;
        let mount = |words: String| PyValueError::new_err(format!("t_base_lidar {words}"));
        let lidar = |numbers| near(arrays::pose(numbers)?, LARGEST_VEHICLE).map_err(mount);
        let lidars = t_base_lidar.iter().map(lidar).collect::<PyResult<Vec<_>>>()?;
        let further = |(k, topic): (usize, &String)| SensorTopic { topic: topic.clone(), t_base_lidar: lidars.get(k).copied() };
        let options = OpenOptions {
            poses,
            pose_kind: if odometry { PoseKind::Odometry } else { PoseKind::Optimised },
            graph,
            t_base_lidar: lidars.first().copied(),
            pose_change: pose_change.parse().map_err(|e: String| PyValueError::new_err(format!("pose_change: {e}")))?,
            strict,
            keyframing: every.map(|text| text.parse()).transpose().map_err(|e: String| PyValueError::new_err(format!("every: {e}")))?,
            cloud_topic: cloud_topics.first().cloned(),
            more_folders: (1..).zip(more_folders).map(|(k, path)| SensorFolder { path, t_base_lidar: lidars.get(k).copied() }).collect(),
            more_sensors: cloud_topics.iter().enumerate().skip(1).map(further).collect(),
            pose_topic,
            metadata,
            point_times: if point_times.is_empty() {
                PointTimes::default()
            } else {
                point_times.parse().map_err(|e: String| PyValueError::new_err(format!("point_times: {e}")))?
            },
            time_tolerance_s: time_tolerance,
            mount_timeout_s: None,
            ..OpenOptions::default()
        };
        let opened = job::run(py, move || {
            let mut warnings = Warnings::default();
            Source::open_checked(&path, &options, slam, poses_check, &mut warnings).map(|(source, _)| (source, warnings))
        })?;
        let (source, warnings) = opened.map_err(|e| errors::run(py, &e))?;
        let said = warnings.all().iter().map(|w| (w.code.clone(), format!("{}; {}", w.text, in_python(&w.remedy)))).collect();
        Ok((Self { source: Arc::new(Mutex::new(source)) }, said))
    }

    /// What was found, in a few lines.
    fn description(&self, py: Python<'_>) -> String {
        self.with(py, Source::description)
    }

    /// Number of scans, if it is known before they are read.
    fn scans(&self, py: Python<'_>) -> Option<usize> {
        self.with(py, Source::scans)
    }

    /// Whether the scans have poses.
    fn has_poses(&self, py: Python<'_>) -> bool {
        self.with(py, |source| !source.is_raw())
    }

    /// The events from the beginning.
    fn events(&self, py: Python<'_>) -> Events {
        let (inputs, setup) = self.with(py, |source| (source.inputs(), source.odometry_setup().cloned().map(Arc::new)));
        Events { inputs: Arc::new(Mutex::new(inputs)), setup }
    }
}

/// Flags of the command about poses as keywords.
fn in_python(remedy: &str) -> String {
    let keywords = [
        ("--pose-change ", "pose_change="),
        ("--t-base-lidar ", "t_base_lidar="),
        ("--poses-check fix", "poses_check=fix"),
        ("map again", "open again"),
        ("--slam", "slam=True"),
    ];
    keywords.into_iter().fold(remedy.to_owned(), |text, (flag, keyword)| text.replace(flag, keyword))
}

impl Dataset {
    /// The sensor's own tables of beams, if the data contain them.
    pub fn sensor(&self, py: Python<'_>) -> Option<BeamModel> {
        self.with(py, Source::sensor)
    }

    /// A number that differs, as a rule, for other data.
    pub fn fingerprint(&self, py: Python<'_>) -> u64 {
        self.with(py, Source::fingerprint)
    }

    /// Does `work` with the data, without the interpreter lock.
    fn with<R: Send>(&self, py: Python<'_>, work: impl FnOnce(&Source) -> R + Send) -> R {
        py.detach(|| work(&self.source.lock().unwrap_or_else(PoisonError::into_inner)))
    }
}

#[pymethods]
impl Events {
    /// The next event; none at the end.
    fn next<'py>(&self, py: Python<'py>) -> PyResult<Option<Item<'py>>> {
        let inputs = Arc::clone(&self.inputs);
        let input = job::run_short(py, || inputs.lock().unwrap_or_else(PoisonError::into_inner).next())?;
        let found = input.map(|input| match input {
            Input::RawScan(RawScan { node, time, cloud, imu }, _) => {
                let raw = Some(Raw { setup: self.setup.clone(), imu });
                let scan = Scan { scan: Arc::new(CoreScan { node, time, t_map_lidar: Pose::identity(), cloud }), raw };
                Ok(("scan", Py::new(py, scan)?.into_bound(py).into_any()))
            }
            Input::Event(event) => item(py, event),
            Input::Unusable(problem) | Input::BadPose(problem) => {
                Ok(("problem", errors::Kind::File.exception(py, problem).into_value(py).into_bound(py).into_any()))
            }
            _ => Err(errors::bug(&"an input of an unknown kind")),
        });
        found.transpose()
    }
}

impl Events {
    /// The iterator, to be read ahead.
    pub fn shared(&self) -> Arc<Mutex<Inputs>> {
        Arc::clone(&self.inputs)
    }

    /// How its scans are registered, if they have no poses.
    pub fn setup(&self) -> Option<Arc<OdometrySetup>> {
        self.setup.clone()
    }
}

/// An event for Python.
pub fn item<'py>(py: Python<'py>, event: Event) -> PyResult<Item<'py>> {
    let edge = |kind, edge: Edge| {
        let information = edge.information.map(Vec::from);
        let pose = &edge.t_from_to;
        Ok((kind, (edge.from, edge.to, arrays::matrix_of_pose(pose), arrays::numbers_of_pose(pose), information).into_pyobject(py)?.into_any()))
    };
    match event {
        Event::Scan(scan) => Ok(("scan", Py::new(py, Scan::with_pose(scan))?.into_bound(py).into_any())),
        Event::OdometryEdge(e) => edge("odometry", e),
        Event::LoopEdge(e) => edge("loop", e),
        Event::PoseUpdate(poses) => {
            let row = |(node, pose): &(NodeId, Pose)| (*node, arrays::matrix_of_pose(pose), arrays::numbers_of_pose(pose));
            let poses: Vec<_> = poses.iter().map(row).collect();
            Ok(("poses", poses.into_pyobject(py)?.into_any()))
        }
        _ => Err(errors::bug(&"an event of an unknown kind")),
    }
}

#[pymethods]
impl Scan {
    /// A scan of arrays. Of `before`, if it is that with changes, stays what arrays do not tell: which sensor it is of, how it is registered, and, if wanted, its
    /// motion.
    #[staticmethod]
    #[expect(clippy::too_many_arguments, reason = "called by name from Python only")]
    fn of(
        node: NodeId,
        time: f64,
        pose: Option<PyReadonlyArray1<'_, f64>>,
        points: PyReadonlyArray2<'_, f32>,
        rows: usize,
        channels: Channels<'_>,
        before: Option<&Self>,
        keeps_motion: bool,
    ) -> PyResult<Self> {
        let mut cloud = arrays::cloud(&points, rows, channels)?;
        if let Some(before) = before.map(|before| &before.scan.cloud) {
            cloud.sensor = before.sensor;
            if keeps_motion {
                cloud.motion.clone_from(&before.motion);
            }
        }
        let raw = pose.is_none().then(|| before.and_then(|before| before.raw.clone()).unwrap_or_default());
        let t_map_lidar = pose.as_ref().map_or_else(|| Ok(Pose::identity()), arrays::pose)?;
        Ok(Self { scan: Arc::new(CoreScan { node, time, t_map_lidar, cloud }), raw })
    }

    /// x, y, z, qx, qy, qz, qw of its pose, if it has one, to the last bit.
    fn exact_pose<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.raw.is_none().then(|| PyArray1::from_slice(py, &arrays::numbers_of_pose(&self.scan.t_map_lidar)))
    }

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

    /// The scan for a mapper as that of `node` at `time`, and how it is to be registered, if it has no pose and the data say so.
    pub fn input(&self, node: NodeId, time: f64) -> (Input, Option<Arc<OdometrySetup>>) {
        let scan = CoreScan { node, time, ..(*self.scan).clone() };
        match &self.raw {
            None => (Input::Event(Event::Scan(scan)), None),
            Some(Raw { setup, imu }) => {
                let raw = RawScan { node, time, cloud: scan.cloud, imu: imu.clone() };
                (Input::RawScan(raw, format!("of node {node}")), setup.clone())
            }
        }
    }
}
