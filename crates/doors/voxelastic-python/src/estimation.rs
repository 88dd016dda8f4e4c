//! Poses of scans: from the scans before, or in a map.

use crate::map::Map;
use crate::{arrays, errors, job};
use numpy::{PyReadonlyArray1, PyReadonlyArray2};
use pyo3::{PyErr, PyResult, Python, pyclass, pymethods};
use std::sync::{Arc, Mutex};
use voxelastic::Cloud;
use voxelastic::surface::MeshOptions;
use voxelastic_slam::loops::{LocaliserSettings, Located, Whereabouts};
use voxelastic_slam::odometry::{OdometrySettings, Status};

/// Poses of scans, one after the other.
#[pyclass(frozen, module = "voxelastic._native")]
pub struct Odometry {
    inner: Arc<Mutex<voxelastic_slam::odometry::Odometry>>,
}

/// Pose, how it was found, piece of the trajectory, whether it is a keyframe, overlap, spread in metres, information, covariance since the first scan of the piece, what is wrong.
type Registered = ([[f64; 4]; 4], &'static str, usize, bool, f64, f64, [[f64; 6]; 6], [[f64; 6]; 6], Option<String>);

#[pymethods]
impl Odometry {
    #[new]
    fn new(voxel_size: Option<f64>, min_range: f64, max_range: f64, deskew: bool) -> Self {
        let mut settings = OdometrySettings::default();
        settings.voxel_size = voxel_size;
        (settings.min_range, settings.max_range) = (min_range, max_range);
        settings.deskew = deskew;
        Self { inner: Arc::new(Mutex::new(voxelastic_slam::odometry::Odometry::new(settings))) }
    }

    /// Registers a scan to those before.
    fn register(
        &self,
        py: Python<'_>,
        points: PyReadonlyArray2<'_, f32>,
        rows: usize,
        time: Option<f64>,
        times: Option<PyReadonlyArray1<'_, f32>>,
    ) -> PyResult<Registered> {
        let cloud = cloud(&points, rows, times)?;
        let pool = job::shared_pool()?;
        let register = || -> PyResult<_> {
            let mut inner = self.inner.lock().map_err(|_| broken())?;
            let odometry = &mut *inner;
            Ok(pool.install(|| odometry.register(&cloud, time)))
        };
        let report = job::run_short(py, register)??;
        let (status, problem) = match report.status {
            Status::First => ("first", None),
            Status::Degenerate { .. } => ("degenerate", None),
            Status::Failed(failure) => ("failed", Some(failure.to_string())),
            _ => ("registered", None),
        };
        let rows = |matrix: &nalgebra::Matrix6<f64>| std::array::from_fn(|i| std::array::from_fn(|j| matrix[(i, j)]));
        let (information, covariance) = (rows(&report.information), rows(&report.covariance));
        let pose = arrays::matrix_of_pose(&report.t_map_lidar);
        Ok((pose, status, report.piece, report.is_keyframe, report.overlap, report.spread, information, covariance, problem))
    }
}

/// Finds scans in a map.
#[pyclass(frozen, module = "voxelastic._native")]
pub struct Localiser {
    inner: Arc<Mutex<voxelastic_slam::loops::Localiser>>,
}

/// Pose, whether it is certain, overlap, contradiction, spread in metres, information.
type Location = ([[f64; 4]; 4], bool, f64, f64, f64, Option<[[f64; 6]; 6]>);

#[pymethods]
impl Localiser {
    /// Prepares the search in a map with surfaces; none if it has none.
    #[staticmethod]
    fn of_map(py: Python<'_>, map: &Map) -> PyResult<Option<Self>> {
        let (content, pool) = (map.content()?, job::shared_pool()?);
        let prepare = move || {
            pool.install(|| {
                let points = content.atlas.unfused_mesh(&MeshOptions::default()).positions;
                let viewpoints = content.atlas.submaps().iter().flat_map(|s| s.scans().iter().map(|scan| s.t_map_submap() * scan.t_submap_lidar));
                (!points.is_empty()).then(|| voxelastic_slam::loops::Localiser::new(points, viewpoints.collect(), LocaliserSettings::default()))
            })
        };
        Ok(job::run(py, prepare)?.map(|localiser| Self { inner: Arc::new(Mutex::new(localiser)) }))
    }

    /// The poses of a scan, the best first; none if it has no returns or fits nowhere. `guess`: a position, and a distance from it in metres.
    fn locate(
        &self,
        py: Python<'_>,
        points: PyReadonlyArray2<'_, f32>,
        rows: usize,
        times: Option<PyReadonlyArray1<'_, f32>>,
        guess: Option<([f64; 3], f64)>,
    ) -> PyResult<Vec<Location>> {
        let (cloud, inner, pool) = (cloud(&points, rows, times)?, Arc::clone(&self.inner), job::shared_pool()?);
        let locate = move || -> PyResult<_> {
            let mut inner = inner.lock().map_err(|_| broken())?;
            let localiser = &mut *inner;
            Ok(pool.install(|| localiser.locate_all(&cloud, guess.map(|(at, within)| Whereabouts { position: at.into(), within, yaw: None }))))
        };
        let found = job::run(py, locate)??;
        let location = |found: &Located| {
            let information = found.information.map(|matrix| std::array::from_fn(|i| std::array::from_fn(|j| matrix[(i, j)])));
            (arrays::matrix_of_pose(&found.t_map_lidar), found.is_certain, found.overlap, found.contradiction, found.spread, information)
        };
        Ok(found.iter().map(location).collect())
    }
}

fn cloud(points: &PyReadonlyArray2<'_, f32>, rows: usize, times: Option<PyReadonlyArray1<'_, f32>>) -> PyResult<Cloud> {
    let points = arrays::rows(points)?.to_vec();
    let time = arrays::numbers(times)?;
    Ok(Cloud { width: points.len() / rows.max(1), height: rows, points, time, ..Cloud::default() })
}

fn broken() -> PyErr {
    errors::bug(&"an earlier call ended early")
}
