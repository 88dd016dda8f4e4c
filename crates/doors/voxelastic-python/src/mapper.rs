//! The mapper: scans, edges and corrections in, a map out.

use crate::arrays::Channels;
use crate::dataset::{Dataset, Events, Scan as DatasetScan};
use crate::map::{Content, Map, SubmapFields, submaps_of};
use crate::{arrays, errors, job, settings};
use numpy::{PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::{Bound, PyErr, PyResult, Python, pyclass, pymethods};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use voxelastic::atlas::Atlas;
use voxelastic::event::{Edge, Event, NodeId, Scan};
use voxelastic::mapper::{Assignment, IdleTask, ScanReport};
use voxelastic::{Cloud, Pose, Settings};
use voxelastic_io::{Keyframing, OpenOptions, Origin};
use voxelastic_run::keep::{CheckpointEvery, Comes, Identity, Resume, SaveOptions, Target};
use voxelastic_run::poses::{Motions, OdometrySetup, OdometryStage, Poses};
use voxelastic_run::{Corrections, Input, MappingRun, Plan, Taken, Warnings};
use voxelastic_slam::slam::RawScan;

/// Turns events into a map. Threads may share it; they take turns.
#[pyclass(frozen, module = "voxelastic._native")]
pub struct Mapper {
    settings: Settings,
    /// None once it is finished.
    run: Arc<Mutex<Option<MappingRun>>>,
    /// How the first scan without a pose is to be registered.
    setup: Arc<Mutex<OdometrySetup>>,
    /// The process that has the threads of the run.
    process: u32,
}

/// Node, submap, how it was chosen, usable returns, pose as a 4 x 4 matrix.
type Report = (u64, u32, &'static str, usize, [[f64; 4]; 4]);

#[pymethods]
impl Mapper {
    #[new]
    fn new(
        py: Python<'_>,
        given: BTreeMap<String, String>,
        loops: Option<bool>,
        optimise: bool,
        path: Option<PathBuf>,
        checkpoints: &str,
        restart: bool,
    ) -> PyResult<Self> {
        let settings = settings::from_text(py, given)?;
        let every: CheckpointEvery = checkpoints.parse().map_err(|problem: String| PyValueError::new_err(format!("checkpoints: {problem}")))?;
        settings.limit_memory().map_err(|e| errors::setting(py, &e))?;
        let pool = job::new_pool(settings.threads)?;
        let setup = Arc::new(Mutex::new(OdometrySetup::new(&OpenOptions::default(), Keyframing::All)));
        let (of_first, threads) = (Arc::clone(&setup), pool.current_num_threads());
        let stage = move || OdometryStage::new(of_first.lock().unwrap_or_else(PoisonError::into_inner).clone(), Motions::default(), threads);
        let corrections = Corrections { optimise, loops, ..Corrections::default() };
        let comes = Comes::InOrder;
        let plan = Plan { settings: settings.clone(), corrections, poses: Poses::Undecided(Box::new(stage)), sensor: None, comes };
        let begin = move || -> voxelastic_run::Result<MappingRun> {
            let Some(path) = path else { return MappingRun::new(plan, pool) };
            let mut warnings = Warnings::default();
            let identity = Identity::new(&plan.settings).with("command", "Python").with("corrections", corrections.identity());
            let mut target = Target::create(&path, SaveOptions::default(), &mut warnings)?;
            let resume = if restart { Resume::Restart } else { Resume::IfSame };
            let (run, sensors) = match resume.find(&mut target, &identity, &mut warnings)? {
                None => (MappingRun::new(plan, pool)?, Vec::new()),
                Some(mut unfinished) => {
                    let mut clouds = unfinished.clouds();
                    let sensors: Vec<u16> = clouds.sensors().collect();
                    (MappingRun::resumed(plan, pool, unfinished, &mut clouds)?, sensors)
                }
            };
            let mut run = run.kept_in(target, identity, every, comes, &sensors);
            run.warnings_mut().append(warnings);
            Ok(run)
        };
        let mut run = job::run(py, begin)?.map_err(|e| errors::run(py, &e))?;
        run.watch_poses();
        Ok(Self { settings, run: Arc::new(Mutex::new(Some(run))), setup, process: std::process::id() })
    }

    /// Scans that an earlier process had integrated, inputs that it had taken, and the node that came last.
    fn resumed(&self, py: Python<'_>) -> PyResult<(usize, u64, Option<NodeId>)> {
        self.with(py, |run| (run.scans_resumed(), run.position().before().inputs, run.last_node()))
    }

    /// Where coordinates of the map are counted from.
    fn origin(&self, py: Python<'_>) -> PyResult<[f64; 3]> {
        self.with(py, |run| run.origin().coordinates())
    }

    /// What was said since this was asked last: codes and texts.
    fn take_warnings(&self, py: Python<'_>) -> PyResult<Vec<(String, String)>> {
        self.with(py, said)
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
        channels: Channels<'_>,
    ) -> PyResult<Report> {
        let cloud = arrays::cloud(&points, rows, channels)?;
        let input = match pose {
            Some(pose) => Input::Event(Event::Scan(Scan { node, time, t_map_lidar: arrays::pose(&pose)?, cloud })),
            None => Input::RawScan(RawScan { node, time, cloud, imu: Vec::new() }, format!("of node {node}")),
        };
        let report = self.handle(py, input, None)?;
        report.ok_or_else(|| errors::bug(&"a scan without a report"))
    }

    /// Integrates a scan as that of `node` at `time`. None: it has no pose, was registered, and is not to be mapped.
    fn integrate_scan(&self, py: Python<'_>, scan: &DatasetScan, node: NodeId, time: f64) -> PyResult<Option<Report>> {
        let (input, setup) = scan.input(node, time);
        self.handle(py, input, setup)
    }

    /// Handles up to `most` events of a data set. Returns the number of scans integrated, and whether that was all. A run that was gone on with goes on after what it
    /// had taken of the same data.
    fn replay(&self, py: Python<'_>, dataset: &Dataset, events: &Events, most: usize) -> PyResult<(usize, Vec<String>, bool)> {
        let (inputs, model, data) = (events.shared(), dataset.sensor(py), dataset.fingerprint(py));
        self.know_setup(events.setup());
        let replayed = self.with(py, |run| {
            let mut inputs = inputs.lock().unwrap_or_else(PoisonError::into_inner);
            if let Some(model) = model {
                run.set_sensor_model(model)?;
            }
            for _ in 0..run.begin_data(data)? {
                inputs.next();
            }
            // The next scans are decoded by threads that would be idle.
            run.set_idle_task(|| inputs.idle_task());
            let (mut scans, mut refused, mut is_over) = (0, Vec::new(), false);
            for _ in 0..most {
                let Some(input) = inputs.next().filter(|_| !run.is_full()) else {
                    is_over = true;
                    break;
                };
                let taken = run.take(input, &mut ());
                scans += taken.integrated.len();
                refused.extend(taken.refused);
                run.keep(false);
            }
            run.set_idle_task(|| IdleTask::new(|| false));
            Ok((scans, refused, is_over))
        })?;
        replayed.map_err(|e| errors::run(py, &e))
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
        self.handle(py, Input::Event(if closes_loop { Event::LoopEdge(edge) } else { Event::OdometryEdge(edge) }), None)?;
        Ok(())
    }

    /// Corrects the poses of nodes: seven numbers for each.
    fn update_poses(&self, py: Python<'_>, nodes: Vec<NodeId>, poses: Vec<PyReadonlyArray1<'_, f64>>) -> PyResult<()> {
        let poses = poses.iter().map(arrays::pose).collect::<PyResult<Vec<_>>>()?;
        self.handle(py, Input::Event(Event::PoseUpdate(nodes.into_iter().zip(poses).collect())), None)?;
        Ok(())
    }

    /// Number of scans and submaps of the present map, fusions done, corrections of root poses, and the description of the sensor.
    fn counts(&self, py: Python<'_>) -> PyResult<(usize, usize, usize, usize, Option<String>)> {
        self.with(py, |run| {
            let mapper = run.mapping().mapper();
            let counts = mapper.elastic_counts();
            let atlas = mapper.atlas();
            (atlas.scan_count(), atlas.submaps().len(), counts.fusions, counts.submap_moves, mapper.sensor().map(str::to_owned))
        })
    }

    /// Points of the last scan that were set aside because they are on something that moves, N x 3, in the map frame.
    fn moving_points<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let points = self.with(py, |run| run.mapping().mapper().moving_points().to_vec())?;
        arrays::from_rows(py, points)
    }

    /// The settings as text.
    fn settings(&self) -> Vec<(&'static str, String)> {
        self.settings.pairs()
    }

    /// The submaps of the present map.
    fn submaps(&self, py: Python<'_>) -> PyResult<Vec<SubmapFields>> {
        self.with(py, |run| submaps_of(run.mapping().mapper().atlas()))
    }

    /// A copy of the present map, or of some of its submaps.
    fn snapshot(&self, py: Python<'_>, only: Option<Vec<u32>>) -> PyResult<Map> {
        let copy = |run: &mut MappingRun| {
            let mapper = run.mapping().mapper();
            let atlas = mapper.atlas();
            let some = |only: &Vec<u32>| {
                let submaps = atlas.submaps().iter().filter(|submap| only.contains(&submap.id())).cloned().collect();
                Atlas::from_submaps(atlas.voxel_size(), submaps)
            };
            (only.as_ref().map_or_else(|| atlas.clone(), some), mapper.sensor().map(str::to_owned), run.origin())
        };
        let (atlas, sensor, origin) = self.with(py, copy)?;
        Ok(Content::new(atlas, self.settings.clone(), sensor, origin).into())
    }

    /// Frees the map. False if it was handed over.
    fn close(&self, py: Python<'_>) -> bool {
        std::process::id() == self.process && py.detach(|| self.run.lock().unwrap_or_else(PoisonError::into_inner).take().is_some())
    }

    /// Completes the map, saves it if it is kept on disk, and hands it over, with what was said meanwhile: codes and texts.
    fn finish(&self, py: Python<'_>) -> PyResult<(Map, Vec<(String, String)>)> {
        self.check_process()?;
        let run = Arc::clone(&self.run);
        // In place first: after Ctrl-C the mapper still has its map, and it is completed.
        let complete = |run: &mut MappingRun| -> voxelastic_run::Result<()> {
            run.finish(&mut ());
            run.complete(&mut NotKept, |_, _| true);
            if run.target().is_some() && run.scans() > 0 {
                run.save()?;
                run.discard_checkpoints();
                let log = run.log();
                run.save_log(&log);
            }
            Ok(())
        };
        job::run(py, move || with(&run, complete))??.map_err(|e| errors::run(py, &e))?;
        let hand_over = || -> PyResult<_> {
            let mut run = self.run.lock().map_err(|_| broken())?.take().ok_or_else(is_finished)?;
            let said = said(&mut run);
            Ok((self.content(run).into(), said))
        };
        job::run_short(py, hand_over)?
    }
}

/// The scans that arrays were made of are the caller's.
struct NotKept;

impl voxelastic::mapper::ScanSource for NotKept {
    fn cloud(&mut self, _: NodeId) -> Result<Cloud, Box<dyn std::error::Error + Send + Sync>> {
        Err("the scans were not kept".into())
    }
}

impl Mapper {
    /// Gives the run an input: what became of the last scan that was integrated by that. A scan without a pose is registered as `setup` says.
    fn handle(&self, py: Python<'_>, input: Input, setup: Option<Arc<OdometrySetup>>) -> PyResult<Option<Report>> {
        self.know_setup(setup);
        let (Taken { integrated, refused }, origin, nothing) = self.with(py, |run| {
            let nothing = without_returns(&input);
            let taken = run.take(input, &mut ());
            run.keep(false);
            (taken, run.origin(), nothing)
        })?;
        match nothing.filter(|_| !refused.is_empty()).or_else(|| refused.into_iter().next()) {
            Some(problem) => Err(errors::Kind::Refused.exception(py, problem)),
            None => Ok(integrated.last().map(|integrated| summary(integrated, origin))),
        }
    }

    fn know_setup(&self, setup: Option<Arc<OdometrySetup>>) {
        if let Some(setup) = setup {
            (*setup).clone_into(&mut self.setup.lock().unwrap_or_else(PoisonError::into_inner));
        }
    }

    /// The map of a run that is complete.
    fn content(&self, run: MappingRun) -> Content {
        let (origin, sensor) = (run.origin(), run.mapping().mapper().sensor().map(str::to_owned));
        Content::new(run.into_atlas(), self.settings.clone(), sensor, origin)
    }

    /// Does `work` with the run, without the interpreter lock.
    fn with<R: Send>(&self, py: Python<'_>, work: impl FnOnce(&mut MappingRun) -> R + Send) -> PyResult<R> {
        self.check_process()?;
        job::run_short(py, || with(&self.run, work))?
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
        // In a process that was forked, dropping the threads would wait for some that are not there.
        if std::process::id() != self.process {
            std::mem::forget(Arc::clone(&self.run));
        }
    }
}

/// Why a scan cannot be used that has no return, whatever would be said about it first; none if it has one.
fn without_returns(input: &Input) -> Option<String> {
    let (node, cloud) = match input {
        Input::Event(Event::Scan(scan)) => (scan.node, &scan.cloud),
        Input::RawScan(scan, _) => (scan.node, &scan.cloud),
        _ => return None,
    };
    let why = match cloud.len() {
        0 => "it has no points".to_owned(),
        count => format!("all of its {count} points are zero or not finite"),
    };
    (!cloud.points.iter().any(Cloud::is_return)).then(|| format!("the scan of node {node} has no usable return: {why}"))
}

/// What a run has said since this was asked last: codes and texts.
fn said(run: &mut MappingRun) -> Vec<(String, String)> {
    run.warnings_mut().take_new().into_iter().map(|w| (w.code, errors::said(&w.text, &w.remedy))).collect()
}

fn with<R: Send>(run: &Mutex<Option<MappingRun>>, work: impl FnOnce(&mut MappingRun) -> R + Send) -> PyResult<R> {
    let mut run = run.lock().map_err(|_| broken())?;
    Ok(work(run.as_mut().ok_or_else(is_finished)?))
}

/// What became of a scan, with its pose in the frame in which poses come.
fn summary((report, pose): &(ScanReport, Pose), origin: Origin) -> Report {
    let assignment = match report.assignment {
        Assignment::Revisit => "revisit",
        Assignment::Overlap => "overlap",
        Assignment::NewSubmap => "new",
        _ => "continue",
    };
    (report.node, report.submap, assignment, report.counts.usable, arrays::matrix_of_pose(&origin.to_map(*pose)))
}

fn is_finished() -> PyErr {
    PyRuntimeError::new_err(
        "the mapper is finished: its map was handed over, or it was closed; make a new Mapper, or take `snapshot()` while mapping goes on",
    )
}

fn broken() -> PyErr {
    PyRuntimeError::new_err("the mapper cannot be used after an internal error; make a new one")
}
