//! How far surfaces and trajectories are from the truth.

use crate::simulation::{Simulation, distance};
use crate::{arrays, job};
use numpy::{PyArray1, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::{Bound, PyErr, PyResult, Python, pyfunction};
use std::fmt::Display;
use voxelastic_eval::align::AlignSettings;
use voxelastic_eval::metrics::{CompareSettings, Map, Truth, compare};
use voxelastic_eval::trajectory::{Fit, Pair, ate};
use voxelastic_eval::{MeshIndex, MeshView};

/// Compares the points of a map, or its mesh, with true points, or with a world: as JSON.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "called by name from Python only")]
pub fn compare_surfaces(
    py: Python<'_>,
    points: PyReadonlyArray2<'_, f32>,
    triangles: Option<PyReadonlyArray2<'_, i32>>,
    truth: PyReadonlyArray2<'_, f32>,
    simulation: Option<&Simulation>,
    align: bool,
    truth_voxel: f32,
    thresholds: Vec<f32>,
    max_points: usize,
) -> PyResult<String> {
    let (points, truth) = (arrays::rows(&points)?.to_vec(), arrays::rows(&truth)?.to_vec());
    let triangles = triangles.map(|triangles| indices(&triangles)).transpose()?;
    let (world, pool) = (simulation.map(Simulation::share), job::shared_pool()?);
    let settings = CompareSettings { align: align.then(AlignSettings::default), truth_voxel, thresholds, max_points, ..CompareSettings::default() };
    let work = move || {
        pool.install(|| {
            let exact = world.map(|world| move |p| distance(&world, p));
            let distance = exact.as_ref().map(|exact| exact as &(dyn Fn([f32; 3]) -> f32 + Sync));
            let map = match &triangles {
                Some(triangles) => Map::Mesh(MeshView::new(&points, triangles)?),
                None => Map::Points(&points),
            };
            compare(map, &Truth { points: &truth, visible: None, distance }, &settings)
        })
    };
    let found = job::run(py, work)?.map_err(|e| wrong(&e))?;
    serde_json::to_string(&found).map_err(|e| wrong(&e))
}

/// Distances from points to a mesh, metres; infinity beyond `cut_off`.
#[pyfunction]
pub fn mesh_distances<'py>(
    py: Python<'py>,
    vertices: PyReadonlyArray2<'py, f32>,
    triangles: PyReadonlyArray2<'py, i32>,
    points: PyReadonlyArray2<'py, f32>,
    cut_off: f32,
) -> PyResult<Bound<'py, PyArray1<f32>>> {
    let (vertices, triangles, points) = (arrays::rows(&vertices)?.to_vec(), indices(&triangles)?, arrays::rows(&points)?.to_vec());
    let pool = job::shared_pool()?;
    let work = move || {
        pool.install(|| Ok::<_, voxelastic_eval::EvalError>(MeshIndex::new(&MeshView::new(&vertices, &triangles)?)?.distances(&points, cut_off)))
    };
    let distances = job::run(py, work)?.map_err(|e| wrong(&e))?;
    Ok(PyArray1::from_vec(py, distances))
}

/// Absolute errors of a trajectory, pose by pose, as JSON, with the errors of the positions in metres. `fit` is `none`, `rigid` or `first`.
#[pyfunction]
pub fn trajectory_errors<'py>(
    py: Python<'py>,
    truth: Vec<PyReadonlyArray1<'py, f64>>,
    estimate: Vec<PyReadonlyArray1<'py, f64>>,
    fit: &str,
) -> PyResult<(String, Bound<'py, PyArray1<f64>>)> {
    let fit = match fit {
        "none" => Fit::None,
        "first" => Fit::FirstPose,
        _ => Fit::Rigid,
    };
    let pairs = truth.iter().zip(&estimate).enumerate();
    let pairs = pairs.map(|(k, (truth, estimate))| Ok(Pair { time: k as f64, reference: arrays::pose(truth)?, estimate: arrays::pose(estimate)? }));
    let found = ate(&pairs.collect::<PyResult<Vec<_>>>()?, fit).map_err(|e| wrong(&e))?;
    let text = serde_json::to_string(&found).map_err(|e| wrong(&e))?;
    Ok((text, PyArray1::from_vec(py, found.errors_m)))
}

fn indices(triangles: &PyReadonlyArray2<'_, i32>) -> PyResult<Vec<[u32; 3]>> {
    let rows = arrays::rows(triangles)?.iter();
    rows.map(|corners| {
        let [a, b, c] = corners.map(|corner| u32::try_from(corner).ok());
        a.zip(b).zip(c).map(|((a, b), c)| [a, b, c])
    })
    .collect::<Option<_>>()
    .ok_or_else(|| PyValueError::new_err("triangles: an index is negative"))
}

fn wrong(error: &dyn Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}
