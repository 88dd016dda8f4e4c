//! Messages as clouds, packets, images, poses and transforms.

pub(super) mod camera_info;
pub(super) mod decoder;
pub(super) mod fixes;
mod header;
pub(super) mod images;
pub(super) mod packets;
pub(super) mod point_clouds;
pub(super) mod topic_role;
