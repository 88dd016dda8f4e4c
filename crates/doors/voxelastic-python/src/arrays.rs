//! numpy arrays from and to what the library takes and gives. Arrays from Python are C-contiguous, aligned and of the stated type: `_arrays.py` sees to it.

use bytemuck::Pod;
use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use numpy::{Element, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::{Bound, FromPyObject, PyErr, PyResult, Python};
use voxelastic::{Cloud, Motion, Pose};

/// The rows of an N x 3 array.
pub fn rows<'a, T: Element + Pod>(array: &'a PyReadonlyArray2<'_, T>) -> PyResult<&'a [[T; 3]]> {
    bytemuck::try_cast_slice(array.as_slice()?).map_err(|_| wrong("an array of N x 3 numbers"))
}

/// The numbers of an array.
pub fn numbers<T: Element + Copy>(array: Option<PyReadonlyArray1<'_, T>>) -> PyResult<Option<Vec<T>>> {
    array.map(|array| Ok(array.as_slice()?.to_vec())).transpose()
}

/// An N x 3 array of the same memory.
pub fn from_rows<T: Element + Pod>(py: Python<'_>, rows: Vec<[T; 3]>) -> PyResult<Bound<'_, PyArray2<T>>> {
    let count = rows.len();
    PyArray1::from_vec(py, bytemuck::allocation::cast_vec(rows)).reshape([count, 3])
}

/// Squared norms of quaternions that are as near to 1 as this are those of unit quaternions, whose last bits stay.
const UNIT: f64 = 1e-12;

/// A pose from an array of x, y, z, qx, qy, qz, qw; the quaternion is normalised.
pub fn pose(numbers: &PyReadonlyArray1<'_, f64>) -> PyResult<Pose> {
    let numbers = numbers.as_slice()?.try_into().map_err(|_| wrong("a pose of seven numbers"))?;
    Ok(pose_of_numbers(numbers))
}

fn pose_of_numbers([x, y, z, qx, qy, qz, qw]: [f64; 7]) -> Pose {
    let rotation = Quaternion::new(qw, qx, qy, qz);
    let is_unit = (rotation.norm_squared() - 1.0).abs() < UNIT;
    let rotation = if is_unit { UnitQuaternion::new_unchecked(rotation) } else { UnitQuaternion::from_quaternion(rotation) };
    Pose::from_parts(Translation3::new(x, y, z), rotation)
}

/// The 4 x 4 matrix of a pose of x, y, z, qx, qy, qz, qw.
pub fn matrix_of_numbers(numbers: [f64; 7]) -> [[f64; 4]; 4] {
    matrix_of_pose(&pose_of_numbers(numbers))
}

/// The array of x, y, z, qx, qy, qz, qw of a pose.
pub fn numbers_of_pose(pose: &Pose) -> [f64; 7] {
    let (t, q) = (pose.translation.vector, pose.rotation.coords);
    [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
}

/// The information of an edge from the upper triangle of its matrix.
pub fn information(numbers: &PyReadonlyArray1<'_, f64>) -> PyResult<[f64; 21]> {
    numbers.as_slice()?.try_into().map_err(|_| wrong("21 numbers of an information matrix"))
}

/// The 4 x 4 matrix of a pose, row by row.
pub fn matrix_of_pose(pose: &Pose) -> [[f64; 4]; 4] {
    let m = pose.to_matrix();
    std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)]))
}

/// What points of a scan have beside coordinates: intensities, colours, rings, times in seconds after the time stamp, and the motion during the sweep.
#[derive(FromPyObject)]
pub struct Channels<'py>(
    Option<PyReadonlyArray1<'py, f32>>,
    Option<PyReadonlyArray2<'py, u8>>,
    Option<PyReadonlyArray1<'py, u16>>,
    Option<PyReadonlyArray1<'py, f32>>,
    Option<MotionSamples<'py>>,
);

/// Times of a motion in seconds after the time stamp, and seven numbers for each pose.
type MotionSamples<'py> = (Vec<f32>, Vec<PyReadonlyArray1<'py, f64>>);

/// A cloud of `rows` rows.
pub fn cloud(points: &PyReadonlyArray2<'_, f32>, row_count: usize, channels: Channels<'_>) -> PyResult<Cloud> {
    let points = rows(points)?.to_vec();
    let Channels(intensity, colours, ring, times, motion) = channels;
    Ok(Cloud {
        width: points.len() / row_count.max(1),
        height: row_count,
        points,
        intensity: numbers(intensity)?,
        colours: colours.map(|colours| Ok::<_, PyErr>(rows(&colours)?.to_vec())).transpose()?,
        ring: numbers(ring)?,
        time: numbers(times)?,
        motion: motion.map(motion_through).transpose()?,
        sensor: 0,
    })
}

fn motion_through((times, poses): MotionSamples<'_>) -> PyResult<Motion> {
    let poses = poses.iter().map(pose).collect::<PyResult<Vec<_>>>()?;
    let motion = Motion::through(times.into_iter().zip(poses));
    motion.ok_or_else(|| PyValueError::new_err("motion: expected two poses or more, with ascending finite times"))
}

fn wrong(expected: &str) -> PyErr {
    PyValueError::new_err(format!("expected {expected}"))
}
