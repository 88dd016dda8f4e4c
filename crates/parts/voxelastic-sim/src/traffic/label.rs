//! What points of a simulated scan were measured on.

/// What a point was measured on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum Label {
    /// The world, which stands; or no return.
    #[default]
    Static = 0,
    /// A body that moves at the time of the measurement.
    Moving = 1,
    /// A body that stands, and moves later.
    Resting = 2,
    /// A body that moved before, and stands from now on.
    Settled = 3,
}
