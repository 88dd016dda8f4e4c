//! Disks, memory and processes that fail.

pub(super) mod damage;
#[cfg(target_os = "linux")]
pub(super) mod full_disk;
#[cfg(unix)]
pub(super) mod kills;
#[cfg(target_os = "linux")]
pub(super) mod memory;
#[cfg(target_os = "linux")]
pub(super) mod odd_systems;
#[cfg(target_os = "linux")]
pub(super) mod out_of_memory;
pub(super) mod reliability;
#[cfg(unix)]
pub(super) mod resume;
#[cfg(target_os = "linux")]
pub(super) mod strange_names;
