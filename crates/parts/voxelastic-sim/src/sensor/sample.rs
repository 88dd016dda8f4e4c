//! What a beam measures before noise.

use crate::traffic::Label;

/// The true measurement of a beam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Range along the beam, metres; infinite for no return.
    pub range: f64,
    /// Cosine of the angle of incidence.
    pub cosine: f32,
    /// Albedo of the surface.
    pub albedo: f32,
    /// What was met.
    pub label: Label,
}

/// A beam without return.
pub(super) const NO_RETURN: Sample = Sample { range: f64::INFINITY, cosine: 0.0, albedo: 0.0, label: Label::Static };
