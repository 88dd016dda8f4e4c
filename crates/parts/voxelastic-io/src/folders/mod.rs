//! Folders of clouds: where the clouds are, their order and their times. No cloud is decoded.

mod cloud_files;
mod find_clouds;
mod listing;
mod scan_times;

pub(crate) use cloud_files::{CloudFile, cloud_files_of, scan_numbers};
pub(crate) use find_clouds::{CloudFolder, find_clouds, holds_clouds};
pub(crate) use listing::{has_extension, list, name_of, stem_of};
pub(crate) use scan_times::{ScanTimes, match_times, read_dates, read_scan_times};
