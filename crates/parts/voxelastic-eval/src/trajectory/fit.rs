//! Least-squares rigid motion between matched positions.

use super::Pair;
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use voxelastic::Pose;

/// Maps estimated to reference positions with the least squared error (Umeyama 1991, without scale). Needs at least one pair. On a straight path the
/// roll about it is not determined; the result has an arbitrary one.
pub(super) fn rigid(pairs: &[Pair]) -> Pose {
    let n = pairs.len() as f64;
    let mean = |f: &dyn Fn(&Pair) -> Vector3<f64>| pairs.iter().map(f).sum::<Vector3<f64>>() / n;
    let reference = mean(&|p| p.reference.translation.vector);
    let estimate = mean(&|p| p.estimate.translation.vector);
    let covariance: Matrix3<f64> =
        pairs.iter().map(|p| (p.reference.translation.vector - reference) * (p.estimate.translation.vector - estimate).transpose()).sum();
    let svd = covariance.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
        return Pose::from_parts(Translation3::from(reference - estimate), UnitQuaternion::identity());
    };
    let mut fix = Matrix3::identity();
    if (u * v_t).determinant() < 0.0 {
        // A reflection: flip the direction of the least singular value.
        let weakest = svd.singular_values.imin();
        fix[(weakest, weakest)] = -1.0;
    }
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * fix * v_t));
    Pose::from_parts(Translation3::from(reference - rotation * estimate), rotation)
}
