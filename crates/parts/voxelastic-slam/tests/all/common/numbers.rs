//! Numbers that look random and are the same everywhere.

use nalgebra::Vector6;
use voxelastic::Pose;

/// Numbers that look random and are the same everywhere.
pub struct Numbers(pub u64);

impl Numbers {
    /// Between 0 and 1.
    pub fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    /// About normal, of standard deviation 1.
    pub fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.next()).sum::<f64>() - 6.0
    }

    /// A small motion: standard deviations in metres and radians.
    pub fn motion(&mut self, metres: f64, radians: f64) -> Pose {
        let v = Vector6::from_fn(|i, _| self.normal() * if i < 3 { metres } else { radians });
        Pose::new(v.fixed_rows::<3>(0).into(), v.fixed_rows::<3>(3).into())
    }
}
