//! Ways to write poses down, and frames with other axes.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use voxelastic::geometry::PoseChange;

/// Ways to write a pose down that are mixed up.
pub(super) const CONVENTIONS: [PoseChange; 4] = {
    let plain = PoseChange { inverse: false, w_first: false, scale: 1.0, rows: 0, seconds: 0.0 };
    [plain, PoseChange { w_first: true, ..plain }, PoseChange { inverse: true, ..plain }, PoseChange { inverse: true, w_first: true, ..plain }]
};

/// The 24 rotations that turn axes into axes.
pub(super) fn quarter_turns() -> Vec<UnitQuaternion<f64>> {
    let axes = [Vector3::x(), Vector3::y(), Vector3::z(), -Vector3::x(), -Vector3::y(), -Vector3::z()];
    let pairs = axes.iter().flat_map(|x| axes.iter().filter(|y| x.dot(y) == 0.0).map(move |y| (*x, *y)));
    pairs.map(|(x, y)| UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, y, x.cross(&y)])))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_are_24_turns() {
        let turns = quarter_turns();
        assert_eq!(turns.len(), 24);
        assert!(turns.iter().enumerate().all(|(k, a)| turns[..k].iter().all(|b| a.angle_to(b) > 1.0)));
        assert!(turns.iter().any(|turn| turn.angle() < 1e-12));
    }
}
