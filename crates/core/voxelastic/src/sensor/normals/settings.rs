//! Settings of the plane fit, and the strip width common to its steps.

/// Columns that are processed together: the sums of a strip stay in the second-level cache.
pub(super) const STRIP: usize = 32;

/// Settings of the plane fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NormalSettings {
    /// Half the width of the surface patch that a plane is fitted to, metres. Far away, where pixels are farther apart, the patch is the nearest two pixels on
    /// each side.
    pub half_window: f32,
    /// Range noise (1 sigma, metres) if known; measured from each scan otherwise.
    pub range_noise: Option<f32>,
    /// Patches that are rougher than the range noise explains are accepted as planes up to this deviation along the normal (1 sigma, metres): grass, gravel,
    /// rounding.
    pub roughness: f32,
    /// Largest accepted standard deviation of a normal's direction, radians.
    pub max_uncertainty: f32,
}

impl Default for NormalSettings {
    fn default() -> Self {
        Self { half_window: 0.2, range_noise: None, roughness: 0.015, max_uncertainty: 0.12 }
    }
}
