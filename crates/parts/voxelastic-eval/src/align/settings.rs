//! Settings of the alignment.

use voxelastic::Pose;

/// How strongly large residuals count. The width follows the scale of the residuals (1.4826 times their median size).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Kernel {
    /// Least squares: fastest, for clean data.
    Squares,
    /// Linear beyond the width.
    Huber,
    /// Residuals far beyond the width hardly count: for changed or missing parts.
    #[default]
    Cauchy,
}

/// Settings of [`align`](super::align).
#[derive(Clone, Debug)]
pub struct AlignSettings {
    /// Voxel sizes of the levels, coarse to fine, metres. Default 1.0, 0.4, 0.15.
    pub voxels: Vec<f32>,
    /// Points farther apart than this many voxels are not matched. Default 4.
    pub reach: f32,
    /// Robust kernel. Default Cauchy.
    pub kernel: Kernel,
    /// Most iterations at each level. Default 40.
    pub max_iterations: usize,
    /// Initial guess: maps source to target coordinates. Default identity.
    pub t_target_source: Pose,
    /// Least share of source points that must have a match. Default 0.05.
    pub min_overlap: f64,
}

impl Default for AlignSettings {
    fn default() -> Self {
        let voxels = vec![1.0, 0.4, 0.15];
        Self { voxels, reach: 4.0, kernel: Kernel::default(), max_iterations: 40, t_target_source: Pose::identity(), min_overlap: 0.05 }
    }
}
