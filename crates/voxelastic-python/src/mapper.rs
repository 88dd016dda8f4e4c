//! The mapper: scans, edges and corrections in, a map out.

use crate::dataset::{Dataset, Events, Input, Scan as DatasetScan};
use crate::map::{Content, Map};
use crate::session::{Corrections, Integrated, Session};
use crate::{arrays, errors, job, settings};
use numpy::{PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::{Bound, PyErr, PyResult, Python, pyclass, pymethods};
use rayon::ThreadPool;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use voxelastic::event::{Edge, Event, NodeId, Scan};
use voxelastic::mapper::{Assignment, IdleTask};
use voxelastic::{Cloud, Motion, Settings};
use voxelastic_io::Keyframing;
use voxelastic_slam::slam::RawScan;

/// Turns events into a map. Threads may share it; they take turns.
#[pyclass(frozen, module = "voxelastic._native")]
pub struct Mapper {
    settings: Settings,
    /// None once it is finished.
    session: Arc<Mutex<Option<Session>>>,
    pool: Arc<ThreadPool>,
    /// The process that has the threads of the pool.
    process: u32,
}

/// Node, submap, how it was chosen, usable returns, pose as a 4 x 4 matrix.
type Report = (u64, u32, &'static str, usize, [[f64; 4]; 4]);

/// Times of a motion in seconds after the time stamp, and seven numbers for each pose.
type MotionSamples<'py> = (Vec<f32>, Vec<PyReadonlyArray1<'py, f64>>);

#[pymethods]
impl Mapper {
    #[new]
    fn new(py: Python<'_>, given: BTreeMap<String, String>, loops: Option<bool>, optimise: bool) -> PyResult<Self> {
        let settings = settings::from_text(py, given)?;
        let mapper = voxelastic::Mapper::new(settings.clone()).map_err(|e| errors::setting(py, &e))?;
        let pool = Arc::new(job::new_pool(settings.threads)?);
        let session = Session::new(mapper, Corrections { loops, optimise });
        Ok(Self { settings, session: Arc::new(Mutex::new(Some(session))), pool, process: std::process::id() })
    }

    /// Integrates a scan of points in the lidar frame. Without a pose, that is estimated; `time` is then the time stamp in seconds.
    #[expect(clippy::too_many_arguments, reason = "called by name from Python only")]
    fn integrate(
        &self,
        py: Python<'_>,
        node: NodeId,
        pose: Option<PyReadonlyArray1<'_, f64>>,
        time: f64,
        points: PyReadonlyArray2<'_, f32>,
        rows: usize,
        intensity: Option<PyReadonlyArray1<'_, f32>>,
        colours: Option<PyReadonlyArray2<'_, u8>>,
        ring: Option<PyReadonlyArray1<'_, u16>>,
        times: Option<PyReadonlyArray1<'_, f32>>,
        motion: Option<MotionSamples<'_>>,
    ) -> PyResult<Report> {
        let points = arrays::rows(&points)?.to_vec();
        let cloud = Cloud {
            width: points.len() / rows.max(1),
            height: rows,
            points,
            intensity: arrays::numbers(intensity)?,
            colours: colours.map(|colours| Ok::<_, PyErr>(arrays::rows(&colours)?.to_vec())).transpose()?,
            ring: arrays::numbers(ring)?,
            time: arrays::numbers(times)?,
            motion: motion.as_ref().map(motion_through).transpose()?,
            sensor: 0,
        };
        let input = match pose {
            Some(pose) => Input::Event(Event::Scan(Scan { node, time, t_map_lidar: arrays::pose(&pose)?, cloud })),
            None => Input::Raw(RawScan { node, time, cloud, imu: Vec::new() }, Keyframing::All),
        };
        let report = self.handle(py, input)?;
        report.map(|r| summary(&r)).ok_or_else(|| errors::bug(&"a scan without a report"))
    }

    /// Integrates a scan of a data set. None: it has no pose, was registered, and is not to be mapped.
    fn integrate_scan(&self, py: Python<'_>, scan: &DatasetScan) -> PyResult<Option<Report>> {
        Ok(self.handle(py, scan.input())?.map(|r| summary(&r)))
    }

    /// Handles up to `most` events of a data set. Returns the number of scans integrated, what is wrong with others, and whether that was all.
    fn replay(&self, py: Python<'_>, dataset: &Dataset, events: &Events, most: usize) -> PyResult<(usize, Vec<String>, bool)> {
        let (events, model) = (events.shared(), dataset.sensor(py));
        self.with(py, |session| {
            let mut events = events.lock().unwrap_or_else(PoisonError::into_inner);
            if let Some(model) = model.filter(|_| session.mapper.sensor().is_none()) {
                session.mapper.set_sensor_model(model);
            }
            // The next scans are decoded by threads that would be idle.
            session.mapper.set_idle_task(events.idle_task());
            let (mut scans, mut problems, mut is_over) = (0, Vec::new(), false);
            for _ in 0..most {
                let Some(event) = events.next() else {
                    is_over = true;
                    break;
                };
                match event.map_err(|e| e.to_string()).and_then(|input| take(session, input)) {
                    Ok(report) => scans += usize::from(report.is_some()),
                    Err(problem) => problems.push(problem),
                }
            }
            session.mapper.set_idle_task(IdleTask::new(|| false));
            (scans, problems, is_over)
        })
    }

    /// Adds an edge between consecutive nodes, or one that closes a loop.
    #[pyo3(signature = (closes_loop, from_node, to_node, t_from_to, information))]
    fn add_edge(
        &self,
        py: Python<'_>,
        closes_loop: bool,
        from_node: NodeId,
        to_node: NodeId,
        t_from_to: PyReadonlyArray1<'_, f64>,
        information: Option<PyReadonlyArray1<'_, f64>>,
    ) -> PyResult<()> {
        let information = information.map(|numbers| arrays::information(&numbers)).transpose()?;
        let edge = Edge { from: from_node, to: to_node, t_from_to: arrays::pose(&t_from_to)?, information };
        self.handle(py, Input::Event(if closes_loop { Event::LoopEdge(edge) } else { Event::OdometryEdge(edge) }))?;
        Ok(())
    }

    /// Corrects the poses of nodes: seven numbers for each.
    fn update_poses(&self, py: Python<'_>, nodes: Vec<NodeId>, poses: Vec<PyReadonlyArray1<'_, f64>>) -> PyResult<()> {
        let poses = poses.iter().map(arrays::pose).collect::<PyResult<Vec<_>>>()?;
        self.handle(py, Input::Event(Event::PoseUpdate(nodes.into_iter().zip(poses).collect())))?;
        Ok(())
    }

    /// Number of scans and submaps of the present map, fusions done, corrections of root poses, and the description of the sensor.
    fn counts(&self, py: Python<'_>) -> PyResult<(usize, usize, usize, usize, Option<String>)> {
        self.with(py, |Session { mapper, .. }| {
            let counts = mapper.elastic_counts();
            let atlas = mapper.atlas();
            (atlas.scan_count(), atlas.submaps().len(), counts.fusions, counts.submap_moves, mapper.sensor().map(str::to_owned))
        })
    }

    /// Points of the last scan that were set aside because they are on something that moves, N x 3, in the map frame.
    fn moving_points<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let points = self.with(py, |Session { mapper, .. }| mapper.moving_points().to_vec())?;
        arrays::from_rows(py, points)
    }

    /// The settings as text.
    fn settings(&self) -> Vec<(&'static str, String)> {
        self.settings.pairs()
    }

    /// A copy of the present map.
    fn snapshot(&self, py: Python<'_>) -> PyResult<Map> {
        let (atlas, sensor) = self.with(py, |Session { mapper, .. }| (mapper.atlas().clone(), mapper.sensor().map(str::to_owned)))?;
        Ok(Content { atlas, settings: self.settings.clone(), sensor, origin: voxelastic_io::Origin::default() }.into())
    }

    /// Frees the map; nothing if it was handed over.
    fn close(&self, py: Python<'_>) {
        if std::process::id() == self.process {
            py.detach(|| drop(self.session.lock().unwrap_or_else(PoisonError::into_inner).take()));
        }
    }

    /// Completes the map and hands it over. Also returns what is wrong with the last corrections, if anything is.
    fn finish(&self, py: Python<'_>) -> PyResult<(Map, Option<String>)> {
        self.check_process()?;
        let session = Arc::clone(&self.session);
        let pool = Arc::clone(&self.pool);
        // In place first: after Ctrl-C the mapper still has its map, and it is completed.
        let finished = job::run(py, move || with(&session, &pool, Session::finish))??;
        let take = || -> PyResult<_> { self.session.lock().map_err(|_| broken())?.take().ok_or_else(is_finished) };
        let mapper = py.detach(take)?.mapper;
        let sensor = mapper.sensor().map(str::to_owned);
        let atlas = job::run_short(py, || self.pool.install(|| mapper.into_atlas()))?;
        Ok((Content { atlas, settings: self.settings.clone(), sensor, origin: voxelastic_io::Origin::default() }.into(), finished.err()))
    }
}

impl Mapper {
    fn handle(&self, py: Python<'_>, input: Input) -> PyResult<Option<Integrated>> {
        self.with(py, |session| take(session, input))?.map_err(|problem| errors::Kind::Refused.exception(py, problem))
    }

    /// Does `work` with the session, in the mapper's pool and without the interpreter lock.
    fn with<R: Send>(&self, py: Python<'_>, work: impl FnOnce(&mut Session) -> R + Send) -> PyResult<R> {
        self.check_process()?;
        job::run_short(py, || with(&self.session, &self.pool, work))?
    }

    fn check_process(&self) -> PyResult<()> {
        if std::process::id() == self.process {
            return Ok(());
        }
        Err(PyRuntimeError::new_err(
            "the mapper belongs to the process that this one was forked from; make one here, or start processes with \"spawn\"",
        ))
    }
}

impl Drop for Mapper {
    fn drop(&mut self) {
        // In a process that was forked, dropping the pool would wait for threads that are not there.
        if std::process::id() != self.process {
            std::mem::forget(Arc::clone(&self.pool));
        }
    }
}

fn take(session: &mut Session, input: Input) -> Result<Option<Integrated>, String> {
    match input {
        Input::Event(event) => session.handle(event),
        Input::Raw(scan, keyframing) => session.handle_raw(scan, keyframing),
    }
}

/// Does `work` with the session in `pool`. The lock is the calling thread's: a thread of the pool that waits for a part of the work might begin another
/// call, which would wait for the same lock.
fn with<R: Send>(session: &Mutex<Option<Session>>, pool: &ThreadPool, work: impl FnOnce(&mut Session) -> R + Send) -> PyResult<R> {
    let mut session = session.lock().map_err(|_| broken())?;
    let session = session.as_mut().ok_or_else(is_finished)?;
    Ok(pool.install(|| work(session)))
}

fn summary((report, pose): &Integrated) -> Report {
    let assignment = match report.assignment {
        Assignment::Revisit => "revisit",
        Assignment::Overlap => "overlap",
        Assignment::NewSubmap => "new",
        _ => "continue",
    };
    (report.node, report.submap, assignment, report.counts.usable, arrays::matrix_of_pose(pose))
}

fn motion_through((times, poses): &MotionSamples<'_>) -> PyResult<Motion> {
    let poses = poses.iter().map(arrays::pose).collect::<PyResult<Vec<_>>>()?;
    let motion = Motion::through(times.iter().copied().zip(poses));
    motion.ok_or_else(|| PyValueError::new_err("motion: expected two poses or more, with ascending finite times"))
}

fn is_finished() -> PyErr {
    PyRuntimeError::new_err(
        "the mapper is finished: its map was handed over, or it was closed; make a new Mapper, or take `snapshot()` while mapping goes on",
    )
}

fn broken() -> PyErr {
    PyRuntimeError::new_err("the mapper cannot be used after an internal error; make a new one")
}
