//! Nodes, and what they publish.

#[cfg(all(target_os = "linux", feature = "foxglove"))]
pub(super) mod attacks;
#[cfg(all(unix, feature = "ros2"))]
pub(super) mod distances;
#[cfg(all(unix, feature = "ros2"))]
mod fast_dds;
pub(super) mod live;
#[cfg(all(unix, feature = "ros2", feature = "foxglove"))]
pub(super) mod recorded_topics;
#[cfg(all(unix, feature = "ros2"))]
pub(super) mod robots;
#[cfg(all(unix, feature = "ros2", feature = "foxglove"))]
pub(super) mod zenoh_router;
