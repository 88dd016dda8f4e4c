//! The direction against gravity at a node, as the solver sees it.

use crate::SlamError;
use nalgebra::{Matrix3, Matrix6, UnitQuaternion, Vector3, Vector6};
use voxelastic::event::Vertical;

/// A measurement that is wrong by more than so many standard deviations counts less (Huber): a long acceleration is no gravity.
const HUBER: f64 = 2.0;

/// A measured vertical. It holds the roll and the pitch of its node.
#[derive(Clone, Debug)]
pub(super) struct VerticalFactor {
    pub(super) node: usize,
    up_lidar: Vector3<f64>,
    up_map: Vector3<f64>,
    /// Inverse square radians.
    information: f64,
}

/// What a factor adds at the pose of its node.
pub(super) struct VerticalShare {
    pub(super) gradient: Vector6<f64>,
    pub(super) block: Matrix6<f64>,
    pub(super) cost: f64,
}

impl VerticalFactor {
    /// # Errors
    /// When it is no measurement.
    pub(super) fn new(node: usize, measured: &Vertical) -> Result<Self, SlamError> {
        let unit = |v: [f64; 3]| Vector3::from(v).try_normalize(1e-6).filter(|v| v.iter().all(|c| c.is_finite()));
        let sigma = Some(measured.sigma).filter(|sigma| sigma.is_finite() && *sigma > 0.0);
        match (unit(measured.up_lidar), unit(measured.up_map), sigma) {
            (Some(up_lidar), Some(up_map), Some(sigma)) => Ok(Self { node, up_lidar, up_map, information: 1.0 / (sigma * sigma) }),
            _ => Err(SlamError::BadVertical { node: measured.node }),
        }
    }

    /// How far the node is from the measurement, in standard deviations.
    pub(super) fn deviation(&self, rotation: &UnitQuaternion<f64>) -> f64 {
        self.residual(rotation).norm() * self.information.sqrt()
    }

    /// The turn from where up is by the pose to where it was measured, lidar frame, radians for small ones.
    fn residual(&self, rotation: &UnitQuaternion<f64>) -> Vector3<f64> {
        self.up_lidar.cross(&(rotation.inverse() * self.up_map))
    }

    /// Its share of the gradient, of the matrix and of the cost.
    pub(super) fn share(&self, rotation: &UnitQuaternion<f64>) -> VerticalShare {
        let by_pose = rotation.inverse() * self.up_map;
        let residual = self.up_lidar.cross(&by_pose);
        let deviation = self.deviation(rotation);
        let (weight, cost) =
            if deviation > HUBER { (HUBER / deviation, HUBER * (deviation - 0.5 * HUBER)) } else { (1.0, 0.5 * deviation * deviation) };
        // Derivative of the residual with the rotation of the lidar in its own frame.
        let derivative = by_pose * self.up_lidar.transpose() - Matrix3::identity() * self.up_lidar.dot(&by_pose);
        let weighted = weight * self.information;
        let (mut gradient, mut block) = (Vector6::zeros(), Matrix6::zeros());
        gradient.fixed_rows_mut::<3>(0).copy_from(&(weighted * derivative.tr_mul(&residual)));
        block.fixed_view_mut::<3, 3>(0, 0).copy_from(&(weighted * derivative.tr_mul(&derivative)));
        VerticalShare { gradient, block, cost }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gradient_is_that_of_the_cost() {
        for (k, up) in [[0.0, 0.0, 1.0], [0.1, 0.2, 0.9], [0.6, -0.1, 0.7]].into_iter().enumerate() {
            let measured = Vertical { node: 3, up_lidar: up, up_map: [0.0, 0.05, 1.0], sigma: 0.3 };
            let factor = VerticalFactor::new(0, &measured).unwrap();
            let rotation = UnitQuaternion::from_euler_angles(0.2, -0.1, k as f64);
            let share = factor.share(&rotation);
            for axis in 0..3 {
                let step = |h: f64| rotation * UnitQuaternion::from_scaled_axis(Vector3::ith(axis, h));
                let numeric = (factor.share(&step(1e-6)).cost - factor.share(&step(-1e-6)).cost) / 2e-6;
                assert!((numeric - share.gradient[axis]).abs() < 1e-5, "{k} {axis}: {numeric} {}", share.gradient);
            }
        }
    }

    #[test]
    fn what_is_no_measurement_is_refused() {
        let good = Vertical { node: 3, up_lidar: [0.0, 0.0, 1.0], up_map: [0.0, 0.0, 1.0], sigma: 0.01 };
        assert!(VerticalFactor::new(0, &good).is_ok());
        for bad in [Vertical { sigma: 0.0, ..good }, Vertical { up_lidar: [0.0; 3], ..good }, Vertical { up_map: [f64::NAN, 0.0, 1.0], ..good }] {
            assert!(VerticalFactor::new(0, &bad).is_err(), "{bad:?}");
        }
    }
}
