//! Voxelastic turns LiDAR scans, with poses that a SLAM system may correct later, into one dense map that bends with the corrections.

pub mod atlas;
pub mod cloud;
mod dispatch;
pub mod event;
pub mod field;
pub mod geometry;
pub mod integrate;
pub mod mapper;
pub mod motion;
pub mod octree;
pub mod query;
pub mod sensor;
pub mod settings;
pub mod surface;

pub use cloud::Cloud;
pub use geometry::Pose;
pub use mapper::Mapper;
pub use motion::Motion;
pub use settings::Settings;
