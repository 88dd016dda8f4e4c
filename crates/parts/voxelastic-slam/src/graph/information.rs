//! What an edge knows: its information matrix, checked.

use crate::SlamError;
use nalgebra::Matrix6;
use voxelastic::Pose;
use voxelastic::event::Edge;

/// Information (x y z roll pitch yaw, diagonal) of an edge `length` metres long that comes without: 2 cm and 1 % of the length, 0.2 degrees.
pub fn default_information(length: f64) -> [f64; 6] {
    let (distance, angle) = (0.02 + 0.01 * length, 0.2f64.to_radians());
    [distance, distance, distance, angle, angle, angle].map(|sigma| 1.0 / (sigma * sigma))
}

/// The upper triangle of a symmetric matrix, row by row, as edges have their information.
pub(crate) fn upper_triangle(matrix: &Matrix6<f64>) -> [f64; 21] {
    let mut upper = [0.0; 21];
    (0..6).for_each(|i| (i..6).for_each(|j| upper[place(i, j)] = matrix[(i, j)]));
    upper
}

/// The symmetric matrix of such a triangle.
pub(crate) fn symmetric(upper: &[f64; 21]) -> Matrix6<f64> {
    Matrix6::from_fn(|i, j| upper[place(i.min(j), i.max(j))])
}

/// Moves a small motion (x y z roll pitch yaw) from the frame of the pose to that in which it is.
pub(crate) fn adjoint(pose: &Pose) -> Matrix6<f64> {
    let rotation = *pose.rotation.to_rotation_matrix().matrix();
    let mut adjoint = Matrix6::zeros();
    adjoint.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    adjoint.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
    adjoint.fixed_view_mut::<3, 3>(0, 3).copy_from(&(pose.translation.vector.cross_matrix() * rotation));
    adjoint
}

/// The information of an edge as the solvers order it, rotation first, and whether it was used whole. Public graphs (`cubicle`) have edges whose
/// information is not positive definite only for what couples translation and rotation; without it, it is.
pub(crate) fn usable_information(edge: &Edge) -> Result<(Matrix6<f64>, bool), SlamError> {
    let whole = rotation_first(edge);
    if whole.cholesky().is_some() {
        return Ok((whole, true));
    }
    let blocks = Matrix6::from_fn(|i, j| if (i < 3) == (j < 3) { whole[(i, j)] } else { 0.0 });
    match blocks.cholesky() {
        Some(_) => Ok((blocks, false)),
        None => Err(SlamError::BadEdge { from: edge.from, to: edge.to, reason: "its information matrix is not positive definite" }),
    }
}

fn rotation_first(edge: &Edge) -> Matrix6<f64> {
    let upper = edge.information.unwrap_or_else(|| {
        let diagonal = default_information(edge.t_from_to.translation.vector.norm());
        let mut upper = [0.0; 21];
        (0..6).for_each(|i| upper[place(i, i)] = diagonal[i]);
        upper
    });
    Matrix6::from_fn(|i, j| {
        let (i, j) = ((i + 3) % 6, (j + 3) % 6);
        upper[place(i.min(j), i.max(j))]
    })
}

/// Place of an entry in the upper triangle, row by row.
fn place(row: usize, column: usize) -> usize {
    row * 6 - row * (row + 1) / 2 + column
}
