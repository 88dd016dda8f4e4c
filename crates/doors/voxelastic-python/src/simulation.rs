//! Simulated scans of exactly known worlds.

use crate::dataset::{Item, Scan, item};
use crate::{arrays, errors, job};
use numpy::{PyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::{Bound, PyResult, Python, pyclass, pyfunction, pymethods};
use rayon::prelude::*;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use voxelastic::event::Event;
use voxelastic_sim::drift::LoopSettings;
use voxelastic_sim::sensor::{LidarSettings, Noise};
use voxelastic_sim::{PoseSource, SimError, SimOptions, scenes};

/// Depth inside of solids to which distances are computed, metres.
const DEEPEST_M: f64 = 1.0;

/// A simulation.
#[pyclass(frozen, module = "voxelastic._native")]
pub struct Simulation {
    inner: Arc<voxelastic_sim::Simulation>,
}

/// The worlds.
#[pyfunction]
pub fn world_names() -> Vec<&'static str> {
    scenes::names().collect()
}

#[pymethods]
impl Simulation {
    #[new]
    #[expect(clippy::too_many_arguments, reason = "called by name from Python only")]
    fn new(
        py: Python<'_>,
        world: String,
        scans: Option<usize>,
        spacing: f64,
        rate: Option<f64>,
        sensor: String,
        columns: Option<usize>,
        max_range: f64,
        noise: f64,
        moving: bool,
        drift: f64,
        loop_radius: f64,
        seed: u64,
    ) -> PyResult<Self> {
        let options = SimOptions {
            seed,
            sensor,
            columns,
            scans,
            spacing,
            rate,
            drift,
            lidar: LidarSettings { max_range, moving, noise: Noise::default().times(noise), ..LidarSettings::default() },
            loops: LoopSettings { radius: loop_radius, ..LoopSettings::default() },
            ..SimOptions::of(world)
        };
        let pool = job::shared_pool()?;
        let made = job::run(py, move || pool.install(|| voxelastic_sim::Simulation::new(options)))?;
        Ok(Self { inner: Arc::new(made.map_err(|e| PyValueError::new_err(e.to_string()))?) })
    }

    /// Number of scans.
    fn len(&self) -> usize {
        self.inner.len()
    }

    /// True poses and those of the odometry as 4 x 4 matrices, and the times.
    #[expect(clippy::type_complexity, reason = "a tuple of arrays for Python")]
    fn poses(&self) -> (Vec<[[f64; 4]; 4]>, Vec<[[f64; 4]; 4]>, Vec<f64>) {
        let matrices = |source| self.inner.poses(source).iter().map(arrays::matrix_of_pose).collect();
        (matrices(PoseSource::Truth), matrices(PoseSource::Odometry), self.inner.times().to_vec())
    }

    /// Scan `k` with its true pose.
    fn scan(&self, py: Python<'_>, k: usize) -> PyResult<Scan> {
        let pool = job::shared_pool()?;
        let scan = job::run_short(py, || pool.install(|| self.inner.scan(k, PoseSource::Truth)))?;
        scan.map(Scan::with_pose).ok_or_else(|| PyValueError::new_err("there is no such scan"))
    }

    /// What a SLAM system would report at scan `k`, in order.
    fn events<'py>(&self, py: Python<'py>, k: usize) -> PyResult<Vec<Item<'py>>> {
        let pool = job::shared_pool()?;
        let scan = job::run_short(py, || pool.install(|| self.inner.scan(k, PoseSource::Online)))?;
        let edge = k.checked_sub(1).and_then(|before| self.inner.odometry_edges().get(before));
        let closing = self.inner.loop_edges().iter().position(|edge| edge.to == k as u64);
        let closed = closing.map(|at| {
            let poses = (0..).zip(self.inner.corrections()[at].poses.iter().copied()).collect();
            [Event::LoopEdge(self.inner.loop_edges()[at].clone()), Event::PoseUpdate(poses)]
        });
        let events = scan.map(Event::Scan).into_iter().chain(edge.cloned().map(Event::OdometryEdge)).chain(closed.into_iter().flatten());
        events.map(|event| item(py, event)).collect()
    }

    /// Writes a folder. Ctrl-C ends it after the scans that are under way.
    fn write(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let (inner, pool, stop) = (Arc::clone(&self.inner), job::shared_pool()?, Arc::new(AtomicBool::new(false)));
        let stopped = Arc::clone(&stop);
        let mut progress = move |_, _| if stopped.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
        let written = job::run(py, move || pool.install(|| inner.write(path, &mut progress)));
        if written.is_err() {
            stop.store(true, Ordering::Relaxed);
        }
        written?.map(drop).map_err(|e| file(py, &e))
    }

    /// Exact signed distances from points to the surfaces of the world.
    fn distance<'py>(&self, py: Python<'py>, points: PyReadonlyArray2<'py, f64>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let (points, pool) = (arrays::rows(&points)?, job::shared_pool()?);
        let world = self.inner.world();
        let distances: Vec<f64> = job::run_short(py, || pool.install(|| points.par_iter().map(|p| world.distance_within(*p, DEEPEST_M)).collect()))?;
        Ok(PyArray1::from_vec(py, distances))
    }

    /// Points of the surface that the sensor can see, one in each cube of `spacing` metres.
    fn surface<'py>(&self, py: Python<'py>, spacing: f64, max_range: f64) -> PyResult<Bound<'py, numpy::PyArray2<f32>>> {
        let (inner, pool) = (Arc::clone(&self.inner), job::shared_pool()?);
        let cast = move || pool.install(|| inner.visible_surface(spacing, max_range).iter().map(|s| s.point.map(|c| c as f32)).collect());
        let points: Vec<[f32; 3]> = job::run(py, cast)?;
        arrays::from_rows(py, points)
    }
}

impl Simulation {
    /// The simulation, for work that may outlive a call.
    pub fn share(&self) -> Arc<voxelastic_sim::Simulation> {
        Arc::clone(&self.inner)
    }
}

/// Exact distance from `p` to the world, metres, signed.
pub fn distance(simulation: &voxelastic_sim::Simulation, p: [f32; 3]) -> f32 {
    simulation.world().distance_within(p.map(f64::from), DEEPEST_M) as f32
}

fn file(py: Python<'_>, error: &SimError) -> pyo3::PyErr {
    errors::Kind::File.exception(py, error.to_string())
}
