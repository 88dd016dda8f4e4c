//! From the fields of a file's point records to a cloud: shared by PCD, PLY, KITTI records and ROS messages.

mod colours;
mod raw_cloud;
mod record;
mod roles;
mod text_table;
mod times;

pub(crate) use raw_cloud::RawCloud;
pub(crate) use record::{Column, Field, Scalar, points};
pub(crate) use roles::{FieldRoles, IN_CURVATURE, is_time, undistorted_sign};
pub(crate) use text_table::{Numbers, Table, split_line};
