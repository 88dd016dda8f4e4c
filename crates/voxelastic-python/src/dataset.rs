//! Scans and poses of folders and recordings, as events.

use crate::{arrays, errors, job};
use numpy::{PyArray1, PyArray2, PyReadonlyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::types::PyTuple;
use pyo3::{Bound, IntoPyObject, Py, PyAny, PyResult, Python, pyclass, pymethods};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use voxelastic::event::{Edge, Event, NodeId, Scan as CoreScan};
use voxelastic_io::source::{self, Events as SourceEvents, Source};
use voxelastic_io::{OpenOptions, PoseKind};

/// A folder or a recording.
#[pyclass(frozen, module = "voxelastic._native")]
pub struct Dataset {
    source: Arc<Mutex<Source>>,
}

/// An iterator over the events of a data set.
#[pyclass(frozen, module = "voxelastic._native")]
pub struct Events {
    events: Arc<Mutex<SourceEvents>>,
}

/// A scan of a data set.
#[pyclass(frozen, module = "voxelastic._native")]
pub struct Scan {
    scan: Arc<CoreScan>,
}

/// An event: its kind, and a scan, or two nodes with a 4 x 4 matrix, or a list of nodes with such matrices, or what is wrong with a scan.
type Item<'py> = (&'static str, Bound<'py, PyAny>);

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
        t_base_lidar: Option<PyReadonlyArray1<'_, f64>>,
        every: Option<String>,
        cloud_topic: Option<String>,
        pose_topic: Option<String>,
        metadata: Option<PathBuf>,
        deskew: bool,
        time_tolerance: f64,
        strict: bool,
    ) -> PyResult<Self> {
        let options = OpenOptions {
            poses,
            pose_kind: if odometry { PoseKind::Odometry } else { PoseKind::Optimised },
            graph,
            t_base_lidar: t_base_lidar.as_ref().map(arrays::pose).transpose()?,
            strict,
            keyframing: every.map(|text| text.parse()).transpose().map_err(|e: String| PyValueError::new_err(format!("every: {e}")))?,
            cloud_topic,
            pose_topic,
            metadata,
            deskew,
            time_tolerance_s: time_tolerance,
        };
        let opened = job::run(py, move || source::open(&path, &options))?;
        Ok(Self { source: Arc::new(Mutex::new(opened.map_err(|e| errors::file(py, &e))?)) })
    }

    /// What was found, in a few lines.
    fn description(&self, py: Python<'_>) -> String {
        self.with(py, |source| source.description())
    }

    /// Number of scans, if it is known before they are read.
    fn scans(&self, py: Python<'_>) -> Option<usize> {
        self.with(py, |source| source.scans())
    }

    /// The events from the beginning.
    fn events(&self, py: Python<'_>) -> Events {
        Events { events: Arc::new(Mutex::new(self.with(py, |source| source.events()))) }
    }
}

impl Dataset {
    /// Does `work` with the source, without the interpreter lock.
    pub fn with<R: Send>(&self, py: Python<'_>, work: impl FnOnce(&Source) -> R + Send) -> R {
        py.detach(|| work(&self.source.lock().unwrap_or_else(PoisonError::into_inner)))
    }
}

#[pymethods]
impl Events {
    /// The next event; none at the end.
    fn next<'py>(&self, py: Python<'py>) -> PyResult<Option<Item<'py>>> {
        let events = Arc::clone(&self.events);
        let event = job::run_short(py, || events.lock().unwrap_or_else(PoisonError::into_inner).next())?;
        event.map(|event| item(py, event)).transpose()
    }
}

impl Events {
    /// The iterator, to be read ahead.
    pub fn shared(&self) -> Arc<Mutex<SourceEvents>> {
        Arc::clone(&self.events)
    }
}

fn item<'py>(py: Python<'py>, event: voxelastic_io::Result<Event>) -> PyResult<Item<'py>> {
    let edge = |kind, edge: Edge| Ok((kind, (edge.from, edge.to, arrays::matrix_of_pose(&edge.t_from_to)).into_pyobject(py)?.into_any()));
    match event {
        Ok(Event::Scan(scan)) => Ok(("scan", Py::new(py, Scan { scan: Arc::new(scan) })?.into_bound(py).into_any())),
        Ok(Event::OdometryEdge(e)) => edge("odometry", e),
        Ok(Event::LoopEdge(e)) => edge("loop", e),
        Ok(Event::PoseUpdate(poses)) => {
            let poses: Vec<(NodeId, [[f64; 4]; 4])> = poses.iter().map(|(node, pose)| (*node, arrays::matrix_of_pose(pose))).collect();
            Ok(("poses", poses.into_pyobject(py)?.into_any()))
        }
        Ok(_) => Err(errors::bug(&"an event of an unknown kind")),
        Err(error) => Ok(("problem", errors::file(py, &error).into_value(py).into_bound(py).into_any())),
    }
}

#[pymethods]
impl Scan {
    /// Its node, time stamp in seconds, and pose as a 4 x 4 matrix.
    fn stamp(&self) -> (NodeId, f64, [[f64; 4]; 4]) {
        (self.scan.node, self.scan.time, arrays::matrix_of_pose(&self.scan.t_map_lidar))
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
        Some(Self { scan: Arc::new(CoreScan { node: *node, time: *time, t_map_lidar: *t_map_lidar, cloud }) })
    }
}

impl Scan {
    /// The scan as an event.
    pub fn event(&self) -> Event {
        Event::Scan((*self.scan).clone())
    }
}
