//! GPS time and UTC.

/// GPS time is ahead of UTC by this since 2017, seconds.
pub const LEAP_SECONDS: f64 = 18.0;
