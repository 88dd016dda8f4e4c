//! The crate's error type.

use crate::field::SnapshotError;
use crate::mapper::{MapError, RebuildError};
use crate::sensor::SensorError;
use crate::settings::SettingError;

/// Any error of this crate. Functions with a single cause of failure return that cause; `?` converts it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A setting is unknown or out of range, or settings contradict each other.
    #[error(transparent)]
    Settings(#[from] SettingError),
    /// A sensor is unknown, or cannot be determined from a cloud.
    #[error(transparent)]
    Sensor(#[from] SensorError),
    /// An event was refused; the map is unchanged.
    #[error(transparent)]
    Map(#[from] MapError),
    /// A serialised field is damaged.
    #[error(transparent)]
    Snapshot(#[from] SnapshotError),
    /// A submap could not be rebuilt; it is unchanged.
    #[error(transparent)]
    Rebuild(#[from] RebuildError),
}
