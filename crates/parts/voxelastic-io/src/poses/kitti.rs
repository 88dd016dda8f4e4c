//! KITTI rows: the upper 3 x 4 part of a pose's matrix, row by row, on each line.

use super::trajectory::Trajectory;
use crate::Result;
use crate::text::{Line, ROTATION_TOLERANCE, lines};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion};
use std::path::Path;
use voxelastic::Pose;

const NAMES: [&str; 12] = ["r11", "r12", "r13", "x", "r21", "r22", "r23", "y", "r31", "r32", "r33", "z"];

pub(super) fn parse(text: &str, path: &Path) -> Result<Trajectory> {
    let pose = |line: Line<'_>| {
        let m = line.numbers(line.words(), &NAMES)?;
        let rotation = Matrix3::new(m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]);
        Ok(Pose::from_parts([m[3], m[7], m[11]].into(), nearest_rotation(&rotation, &line)?))
    };
    Ok(Trajectory { poses: lines(path, text).map(pose).collect::<Result<_>>()?, times: None, nodes: None })
}

/// The rotation nearest to a matrix, which must be one within tolerance.
fn nearest_rotation(m: &Matrix3<f64>, line: &Line<'_>) -> Result<UnitQuaternion<f64>> {
    let off = (m.transpose() * m - Matrix3::identity()).amax();
    let fail = |problem: String| Err(line.field_error("r11..r33", problem, "the file is damaged, or its lines are not 3 x 4 poses row by row"));
    if off > ROTATION_TOLERANCE {
        return fail(format!("the matrix is no rotation: its columns are off by {off:.3} from unit length and right angles"));
    }
    if m.determinant() < 0.0 {
        return fail("the matrix is a reflection, not a rotation".into());
    }
    let svd = m.svd(true, true);
    let nearest = svd.u.zip(svd.v_t).map_or(*m, |(u, v_t)| u * v_t);
    Ok(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(nearest)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn matrices_that_are_no_rotation_are_refused() {
        let error = |text: &str| parse(text, Path::new("p.txt")).err().map(|e| e.to_string()).unwrap_or_default();
        assert_eq!(error("1 0 0 5 0 1 0 6 0 0 1 7\n0.9999 0 0 0 0 1.0001 0 0 0 0 1 0\n"), "");
        assert!(error("1 0 0 5 0 1 0 6 0 0 1.1 7\n").contains("line 1, field r11..r33: the matrix is no rotation"));
        assert!(error("1 0 0 5 0 1 0 6 0 0 -1 7\n").contains("reflection"));
        assert!(error("1 0 0 5 0 1 0 6 0 0 1\n").contains("line 1, field z: missing"));
        assert!(error("1 0 0 5 0 1 0 6 0 0 1 inf\n").contains("not finite"));
    }
}
