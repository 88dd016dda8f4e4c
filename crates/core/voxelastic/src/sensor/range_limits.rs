//! The range gate.

/// Range gate: returns outside of it are not used. Metres from the beam's origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeLimits {
    /// Nearer returns are from the vehicle or the operator, or dust on the sensor's window.
    pub near: f32,
    /// Farther returns are not mapped; their beams are free up to this range.
    pub max: f32,
}

impl Default for RangeLimits {
    fn default() -> Self {
        Self { near: 0.5, max: 60.0 }
    }
}
