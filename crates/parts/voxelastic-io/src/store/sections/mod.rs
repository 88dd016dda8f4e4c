//! A submap file and its sections, byte by byte.

pub(super) mod bytes;
pub(super) mod colour_section;
pub(super) mod frames;
pub(super) mod masks;
pub(super) mod occupancy_section;
pub(super) mod origin_section;
pub(super) mod submap_file;
pub(super) mod tsdf_page;
pub(super) mod tsdf_section;
