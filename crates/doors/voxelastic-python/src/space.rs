//! Free space: what robots ask of a map.

use crate::map::{Map, number_of};
use crate::{arrays, errors, job};
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::types::PyAnyMethods;
use pyo3::types::{PyDict, PyDictMethods, PyTuple};
use pyo3::{Bound, IntoPyObject, PyErr, PyResult, Python, pyfunction};
use rayon::prelude::*;
use std::sync::PoisonError;
use std::time::Duration;
use voxelastic::geometry::Aabb;
use voxelastic::query::{AtlasQuery, Axis, DistanceQuery, SliceRequest, UnknownAs};
use voxelastic::sensor::{SensorError, preset, preset_with_columns};
use voxelastic_esdf::{EsdfSample, EsdfSettings};
use voxelastic_plan::{PlanError, Request, Robot, Wheels};

/// Points between two looks for Ctrl-C.
const AT_ONCE: usize = 1 << 15;

/// Points that a thread takes at a time.
const PER_TASK: usize = 64;

/// Whether unknown space blocks.
pub fn unknown_as(blocks: bool) -> UnknownAs {
    if blocks { UnknownAs::Blocked } else { UnknownAs::Free }
}

/// Directions of a sensor's beams, rows x columns x 3, in the lidar frame.
#[pyfunction]
pub fn beam_directions<'py>(py: Python<'py>, sensor: &str, columns: Option<usize>) -> PyResult<(Bound<'py, PyArray2<f64>>, usize)> {
    let model = columns.map_or_else(|| preset(sensor), |columns| preset_with_columns(sensor, columns));
    let model = model.map_err(|error: SensorError| PyValueError::new_err(error.to_string()))?;
    let pixels = (0..model.rows()).flat_map(|row| (0..model.columns()).map(move |column| (row as f32, column as f32)));
    let directions = pixels.map(|(row, column)| model.direction(row, column).map(f64::from)).collect();
    Ok((arrays::from_rows(py, directions)?, model.rows()))
}

/// Distances to the nearest obstacles, metres, `up_to` where there are none nearer.
#[pyfunction]
pub fn clearance<'py>(
    py: Python<'py>,
    map: &Map,
    points: PyReadonlyArray2<'py, f64>,
    up_to: f64,
    unknown_blocks: bool,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let points = arrays::rows(&points)?;
    let (pool, content) = (job::shared_pool()?, map.content()?);
    let space = AtlasQuery::new(&content.atlas);
    let mut clearances = vec![0.0; points.len()];
    for (clearances, points) in clearances.chunks_mut(AT_ONCE).zip(points.chunks(AT_ONCE)) {
        let places = clearances.par_iter_mut().zip(points).with_min_len(PER_TASK);
        let measure = || places.for_each(|(c, p)| *c = space.clearance(*p, up_to, unknown_as(unknown_blocks)));
        job::run_short(py, || pool.install(measure))?;
        py.check_signals()?;
    }
    Ok(PyArray1::from_vec(py, clearances))
}

/// Distances by the Euclidean distance field of the map, metres, and their gradients. Corrected by surfaces if distances are to obstacles only. The map keeps what was
/// made of the field.
#[pyfunction]
pub fn esdf<'py>(
    py: Python<'py>,
    map: &Map,
    points: PyReadonlyArray2<'py, f64>,
    max_distance: f64,
    unknown_blocks: bool,
) -> PyResult<Bound<'py, PyTuple>> {
    let points = arrays::rows(&points)?.to_vec();
    let (pool, content) = (job::shared_pool()?, map.content()?);
    let settings = EsdfSettings { max_distance, unknown: unknown_as(unknown_blocks) };
    let field = content.distance_field(settings).map_err(|error| PyValueError::new_err(error.to_string()))?;
    let sample = move || {
        let mut field = field.lock().unwrap_or_else(PoisonError::into_inner);
        let (field, atlas) = (&mut *field, &content.atlas);
        pool.install(|| if unknown_blocks { field.sample_many(atlas, &points) } else { field.sample_many_to_surfaces(atlas, &points) })
    };
    let samples: Vec<EsdfSample> = job::run(py, sample)?;
    let distances: Vec<f32> = samples.iter().map(|sample| sample.distance).collect();
    let gradients: Vec<[f32; 3]> = samples.iter().map(|sample| sample.gradient).collect();
    (PyArray1::from_vec(py, distances), arrays::from_rows(py, gradients)?).into_pyobject(py)
}

/// States, or distances, of a cross-section, rows from the smallest coordinate on.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "called by name from Python only")]
pub fn slice<'py>(
    py: Python<'py>,
    map: &Map,
    axis: usize,
    at: f64,
    thickness: f64,
    pixel: f64,
    bounds: [[f32; 3]; 2],
    of_distances: bool,
) -> PyResult<Bound<'py, pyo3::PyAny>> {
    let axis = *[Axis::X, Axis::Y, Axis::Z].get(axis).ok_or_else(|| PyValueError::new_err("axis: expected 0, 1 or 2"))?;
    let request = SliceRequest { axis, at, thickness, pixel, bounds: Aabb { min: bounds[0], max: bounds[1] } };
    let (pool, content) = (job::shared_pool()?, map.content()?);
    let atlas = &content.atlas;
    if of_distances {
        let slice = job::run_short(py, || pool.install(|| DistanceQuery::new(atlas).slice(&request)))?;
        return Ok(PyArray1::from_vec(py, slice.distances).reshape([slice.height, slice.width])?.into_any());
    }
    let slice = job::run_short(py, || pool.install(|| AtlasQuery::new(atlas).slice(&request)))?;
    let states = slice.states.into_iter().map(number_of).collect();
    Ok(PyArray1::from_vec(py, states).reshape([slice.height, slice.width])?.into_any())
}

/// A path: its waypoints and what is known about it, by the names of `voxelastic.Path`.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "called by name from Python only")]
pub fn plan<'py>(
    py: Python<'py>,
    map: &Map,
    start: [f64; 3],
    goal: [f64; 3],
    radius: f64,
    wheels: bool,
    step: Option<f64>,
    unknown_blocks: bool,
    time: f64,
    samples: Option<usize>,
    seed: u64,
) -> PyResult<Bound<'py, PyDict>> {
    let ground = wheels.then_some(Wheels { height: None, step });
    let robot = Robot { radius, unknown: unknown_as(unknown_blocks), ground };
    let time = Duration::try_from_secs_f64(time).map_err(|_| PyValueError::new_err("time: expected seconds, 0 or more"))?;
    let request = Request { time, samples, seed, ..Request::new(start, goal, robot) };
    let (pool, map) = (job::shared_pool()?, map.content()?);
    let found = job::run(py, move || pool.install(|| voxelastic_plan::plan(&AtlasQuery::new(&map.atlas), &request)))?;
    let plan = found.map_err(|error| no_plan(py, &error))?;
    let path = PyDict::new(py);
    path.set_item("points", arrays::from_rows(py, plan.path)?)?;
    path.set_item("length", plan.length)?;
    path.set_item("clearance", PyArray1::from_vec(py, plan.clearance))?;
    path.set_item("least_clearance", plan.least_clearance)?;
    Ok(path)
}

/// The exception for a path that was not found, with the nearest place where the robot fits, if it fits nowhere near an end.
fn no_plan(py: Python<'_>, error: &PlanError) -> PyErr {
    let exception = errors::Kind::Plan.exception(py, error.to_string());
    let nearest = if let PlanError::Blocked { nearest, .. } = error { nearest.map(|place| PyArray1::from_slice(py, &place)) } else { None };
    match exception.value(py).setattr("nearest", nearest) {
        Ok(()) => exception,
        Err(error) => error,
    }
}
