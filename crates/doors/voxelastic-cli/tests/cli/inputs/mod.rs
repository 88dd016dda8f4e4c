//! What comes in: folders, recordings, sensors, images; good and bad.

pub(super) mod bad_input;
#[cfg(target_os = "linux")]
pub(super) mod hostile_files;
pub(super) mod images;
pub(super) mod origin;
pub(super) mod point_times;
pub(super) mod recordings;
#[cfg(unix)]
pub(super) mod sensors;
pub(super) mod simulation;
pub(super) mod two_sensors;
