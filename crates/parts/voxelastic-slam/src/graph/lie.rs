//! Small motions as vectors, rotation first: exponential and logarithm of SE(3), adjoints, and the inverse of its Jacobian.

use nalgebra::{Matrix3, Matrix6, Translation3, UnitQuaternion, Vector3, Vector6};
use voxelastic::Pose;

/// Square of an angle below which series are exact, and differences of nearly equal numbers are not.
const SMALL: f64 = 1e-2;

/// The motion of a vector.
pub(crate) fn exp(v: &Vector6<f64>) -> Pose {
    let (w, t) = split(v);
    let (b, c) = coefficients(w.norm_squared());
    let rotation = UnitQuaternion::from_scaled_axis(w);
    let translation = t + b * w.cross(&t) + c * w.cross(&w.cross(&t));
    Pose::from_parts(Translation3::from(translation), rotation)
}

/// The vector of a motion; its angle is at most half a turn.
pub(crate) fn log(pose: &Pose) -> Vector6<f64> {
    let w = pose.rotation.scaled_axis();
    let t = pose.translation.vector;
    let angle2 = w.norm_squared();
    let (b, c) = coefficients(angle2);
    // Inverse of V = I + b [w] + c [w]^2, in the same form.
    let k = if angle2 < SMALL {
        (1.0 + angle2 * (1.0 / 60.0 + angle2 * (1.0 / 2520.0 + angle2 / 100_800.0))) / 12.0
    } else {
        (1.0 - 0.5 * (1.0 - angle2 * c) / b) / angle2
    };
    let t = t - 0.5 * w.cross(&t) + k * w.cross(&w.cross(&t));
    Vector6::new(w.x, w.y, w.z, t.x, t.y, t.z)
}

/// `(1 - cos a) / a^2` and `(a - sin a) / a^3`.
fn coefficients(angle2: f64) -> (f64, f64) {
    if angle2 < SMALL {
        let b = 0.5 - angle2 / 24.0 * (1.0 - angle2 / 30.0 * (1.0 - angle2 / 56.0));
        let c = (1.0 - angle2 / 20.0 * (1.0 - angle2 / 42.0 * (1.0 - angle2 / 72.0))) / 6.0;
        return (b, c);
    }
    let angle = angle2.sqrt();
    ((1.0 - angle.cos()) / angle2, (angle - angle.sin()) / (angle2 * angle))
}

/// Products of many rotations drift off unit length.
pub(crate) fn renormalised(mut pose: Pose) -> Pose {
    pose.rotation.renormalize();
    pose
}

/// Takes vectors in the frame that a pose maps from to the one it maps to.
pub(super) fn adjoint(pose: &Pose) -> Matrix6<f64> {
    let rotation = pose.rotation.to_rotation_matrix();
    let mut out = Matrix6::zeros();
    out.fixed_view_mut::<3, 3>(0, 0).copy_from(rotation.matrix());
    out.fixed_view_mut::<3, 3>(3, 3).copy_from(rotation.matrix());
    out.fixed_view_mut::<3, 3>(3, 0).copy_from(&(hat(&pose.translation.vector) * rotation.matrix()));
    out
}

/// Coefficients of even powers in the series of the inverse Jacobian, from the square on (Bernoulli numbers over factorials).
const SERIES: [f64; 6] = [1.0 / 12.0, -1.0 / 720.0, 1.0 / 30_240.0, -1.0 / 1_209_600.0, 1.0 / 47_900_160.0, -691.0 / 1_307_674_368_000.0];

/// The right inverse Jacobian at `v`: `log(exp(v) exp(d))` is `v` plus this times a small `d`. At `-v`, it is the left one.
pub(super) fn inverse_jacobian(v: &Vector6<f64>) -> Matrix6<f64> {
    let ad = {
        let (w, t) = split(v);
        let mut ad = Matrix6::zeros();
        ad.fixed_view_mut::<3, 3>(0, 0).copy_from(&hat(&w));
        ad.fixed_view_mut::<3, 3>(3, 3).copy_from(&hat(&w));
        ad.fixed_view_mut::<3, 3>(3, 0).copy_from(&hat(&t));
        ad
    };
    let square = ad * ad;
    let mut out = Matrix6::identity() + 0.5 * ad;
    let mut power = square;
    for c in SERIES {
        out += c * power;
        power *= square;
    }
    out
}

/// The transpose of [`inverse_jacobian`] at `v`, applied to a vector.
pub(super) fn inverse_jacobian_transposed(v: &Vector6<f64>, u: &Vector6<f64>) -> Vector6<f64> {
    let (w, t) = split(v);
    let apply = |u: &Vector6<f64>| {
        let (a, b) = split(u);
        // The transpose of [w] is what takes u to u x w.
        let (top, bottom) = (a.cross(&w) + b.cross(&t), b.cross(&w));
        Vector6::new(top.x, top.y, top.z, bottom.x, bottom.y, bottom.z)
    };
    let mut power = apply(u);
    let mut out = u + 0.5 * power;
    let size = v.norm();
    let mut size_left = 1.0;
    for c in SERIES {
        power = apply(&power);
        out += c * power;
        power = apply(&power);
        size_left *= size * size;
        // What follows is below the last digit.
        if size_left < 1e-14 {
            break;
        }
    }
    out
}

fn split(v: &Vector6<f64>) -> (Vector3<f64>, Vector3<f64>) {
    (Vector3::new(v[0], v[1], v[2]), Vector3::new(v[3], v[4], v[5]))
}

fn hat(w: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -w.z, w.y, w.z, 0.0, -w.x, -w.y, w.x, 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Vectors with angles from nearly none to 2.8 radians.
    fn vectors() -> impl Iterator<Item = Vector6<f64>> {
        (0..40u32).map(|k| {
            let direction = Vector6::from_fn(|i, _| (f64::from(k) * 1.7 + i as f64 * 2.3).sin());
            let w = Vector3::new(direction[0], direction[1], direction[2]).normalize() * [1e-9, 1e-4, 0.01, 0.3, 1.2, 2.8][k as usize % 6];
            Vector6::new(w.x, w.y, w.z, 3.0 * direction[3], direction[4], -2.0 * direction[5])
        })
    }

    #[test]
    fn logarithm_undoes_exponential() {
        for v in vectors() {
            assert!((log(&exp(&v)) - v).norm() < 1e-9, "{v}");
        }
    }

    #[test]
    fn jacobians_are_those_of_differences() {
        for v in vectors() {
            let (right, left) = (inverse_jacobian(&v), inverse_jacobian(&-v));
            for axis in 0..6 {
                let step = Vector6::from_fn(|i, _| if i == axis { 1e-6 } else { 0.0 });
                let by_right = (log(&(exp(&v) * exp(&step))) - log(&(exp(&v) * exp(&-step)))) / 2e-6;
                let by_left = (log(&(exp(&step) * exp(&v))) - log(&(exp(&-step) * exp(&v)))) / 2e-6;
                assert!((right.column(axis) - by_right).norm() < 3e-3 && (left.column(axis) - by_left).norm() < 3e-3, "{v}\n{right}");
                if v.fixed_rows::<3>(0).norm() < 2.0 {
                    assert!((right.column(axis) - by_right).norm() < 1e-5, "{v}\n{}", right.column(axis) - by_right);
                }
            }
            let u = Vector6::new(0.3, -1.0, 2.0, 0.5, 0.1, -0.7);
            assert!((inverse_jacobian_transposed(&v, &u) - right.transpose() * u).norm() < 1e-9, "{v}");
        }
    }

    #[test]
    fn the_adjoint_moves_a_motion_to_the_other_side() {
        for v in vectors() {
            let (pose, small) = (exp(&v), Vector6::new(0.01, -0.02, 0.03, 0.1, 0.2, -0.3));
            let (here, there) = (pose * exp(&small), exp(&(adjoint(&pose) * small)) * pose);
            assert!((here.to_homogeneous() - there.to_homogeneous()).norm() < 1e-9);
        }
    }
}
