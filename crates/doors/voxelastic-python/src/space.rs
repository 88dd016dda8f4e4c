//! Free space and rays: what robots and simulated sensors ask of a map.

use crate::map::{Map, number_of};
use crate::{arrays, errors, job};
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::types::{PyDict, PyDictMethods, PyTuple};
use pyo3::{Bound, IntoPyObject, PyResult, Python, pyfunction};
use rayon::prelude::*;
use std::time::Duration;
use voxelastic::atlas::Atlas;
use voxelastic::field::occupancy::State;
use voxelastic::geometry::Aabb;
use voxelastic::query::{AtlasQuery, Axis, DistanceQuery, Ray, RayHit, SliceRequest, UnknownAs};
use voxelastic::sensor::{SensorError, preset, preset_with_columns};
use voxelastic_esdf::{Esdf, EsdfSample, EsdfSettings};
use voxelastic_plan::{Request, Robot, Wheels};

/// Rays and points between two looks for Ctrl-C.
const AT_ONCE: usize = 1 << 15;

/// Rays and points that a thread takes at a time.
const PER_TASK: usize = 64;

/// Whether unknown space blocks.
fn unknown_as(blocks: bool) -> UnknownAs {
    if blocks { UnknownAs::Blocked } else { UnknownAs::Free }
}

/// Distances to where rays end, NaN where they do not; the normals there; the states of what they end in.
#[pyfunction]
pub fn ray_cast<'py>(
    py: Python<'py>,
    map: &Map,
    origins: PyReadonlyArray2<'py, f64>,
    directions: PyReadonlyArray2<'py, f64>,
    length: f64,
    unknown_blocks: bool,
) -> PyResult<Bound<'py, PyTuple>> {
    let (origins, directions) = (arrays::rows(&origins)?, arrays::rows(&directions)?);
    if origins.len() != directions.len() && origins.len() != 1 {
        return Err(PyValueError::new_err("origins: expected one, or as many as directions"));
    }
    let (pool, content) = (job::shared_pool()?, map.content()?);
    let caster = RayCaster::new(&content.atlas, unknown_as(unknown_blocks));
    let ray = |k: usize| Ray { origin: *origins.get(k).unwrap_or(&origins[0]), direction: directions[k], length };
    let mut hits: Vec<Option<RayHit>> = Vec::with_capacity(directions.len());
    for first in (0..directions.len()).step_by(AT_ONCE) {
        let all = || (first..directions.len().min(first + AT_ONCE)).into_par_iter().with_min_len(PER_TASK).map(|k| caster.cast(&ray(k))).collect();
        let part: Vec<Option<RayHit>> = job::run_short(py, || pool.install(all))?;
        hits.extend(part);
        py.check_signals()?;
    }
    let distances: Vec<f64> = hits.iter().map(|hit| hit.map_or(f64::NAN, |hit| hit.distance)).collect();
    let normals: Vec<[f64; 3]> = hits.iter().map(|hit| hit.map_or([0.0; 3], |hit| hit.normal)).collect();
    let states: Vec<u8> = hits.iter().map(|hit| hit.map_or(0, |hit| number_of(hit.state))).collect();
    let arrays = (PyArray1::from_vec(py, distances), arrays::from_rows(py, normals)?, PyArray1::from_vec(py, states));
    arrays.into_pyobject(py)
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
    let space = content.atlas.query();
    let mut clearances = vec![0.0; points.len()];
    for (clearances, points) in clearances.chunks_mut(AT_ONCE).zip(points.chunks(AT_ONCE)) {
        let places = clearances.par_iter_mut().zip(points).with_min_len(PER_TASK);
        let measure = || places.for_each(|(c, p)| *c = space.clearance(*p, up_to, unknown_as(unknown_blocks)));
        job::run_short(py, || pool.install(measure))?;
        py.check_signals()?;
    }
    Ok(PyArray1::from_vec(py, clearances))
}

/// Distances by the Euclidean distance field of the map, metres, and their gradients. Corrected by surfaces if distances are to obstacles only.
#[pyfunction]
pub fn esdf<'py>(
    py: Python<'py>,
    map: &Map,
    points: PyReadonlyArray2<'py, f64>,
    max_distance: f64,
    unknown_blocks: bool,
) -> PyResult<Bound<'py, PyTuple>> {
    let points = arrays::rows(&points)?;
    let (pool, content) = (job::shared_pool()?, map.content()?);
    let atlas = &content.atlas;
    let settings = EsdfSettings { max_distance, unknown: unknown_as(unknown_blocks) };
    let mut field = Esdf::new(settings, atlas.voxel_size()).map_err(|error| PyValueError::new_err(error.to_string()))?;
    job::run_short(py, || pool.install(|| field.update(atlas)))?;
    let mut samples: Vec<EsdfSample> = Vec::with_capacity(points.len());
    let query = field.query(atlas);
    for points in points.chunks(AT_ONCE) {
        let part =
            job::run_short(py, || pool.install(|| if unknown_blocks { query.sample_many(points) } else { query.sample_many_to_surfaces(points) }))?;
        samples.extend(part);
        py.check_signals()?;
    }
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
    let slice = job::run_short(py, || pool.install(|| atlas.query().slice(&request)))?;
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
    let found = job::run(py, move || pool.install(|| voxelastic_plan::plan(&map.atlas.query(), &request)))?;
    let plan = found.map_err(|error| errors::Kind::Plan.exception(py, error.to_string()))?;
    let path = PyDict::new(py);
    path.set_item("points", arrays::from_rows(py, plan.path)?)?;
    path.set_item("length", plan.length)?;
    path.set_item("clearance", PyArray1::from_vec(py, plan.clearance))?;
    path.set_item("least_clearance", plan.least_clearance)?;
    Ok(path)
}

/// Casts rays to voxels, and from there to the surface in them where the map has signed distances.
struct RayCaster<'a> {
    space: AtlasQuery<'a>,
    surfaces: DistanceQuery<'a>,
    unknown: UnknownAs,
}

impl<'a> RayCaster<'a> {
    fn new(atlas: &'a Atlas, unknown: UnknownAs) -> Self {
        Self { space: atlas.query(), surfaces: DistanceQuery::new(atlas), unknown }
    }

    fn cast(&self, ray: &Ray) -> Option<RayHit> {
        let mut hit = self.space.ray_cast(ray, self.unknown)?;
        if hit.state == State::Occupied && !self.surfaces.is_empty() {
            hit.distance = self.crossing(ray, hit.distance).unwrap_or(hit.distance);
        }
        Some(hit)
    }

    /// The distance along a ray at which it passes through a surface from its front, if that is within two voxels of `near`.
    fn crossing(&self, ray: &Ray, near: f64) -> Option<f64> {
        const STEPS: u32 = 16;
        let (voxel, norm) = (self.space.voxel_size(), ray.direction.iter().map(|c| c * c).sum::<f64>().sqrt());
        let at =
            |distance: f64| self.surfaces.sample(std::array::from_fn(|k| ray.origin[k] + ray.direction[k] * distance / norm)).map(|s| s.distance);
        let mut before: Option<(f64, f32)> = None;
        for step in 0..=STEPS {
            let distance = near + voxel * (4.0 * f64::from(step) / f64::from(STEPS) - 2.0);
            let value = at(distance);
            if let (Some((last, front)), Some(behind)) = (before, value)
                && front > 0.0
                && behind <= 0.0
            {
                return Some(last + (distance - last) * f64::from(front / (front - behind)));
            }
            before = value.map(|value| (distance, value));
        }
        None
    }
}
