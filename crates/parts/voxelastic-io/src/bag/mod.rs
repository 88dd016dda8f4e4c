//! Recordings of ROS 1 (`.bag`) and ROS 2 (MCAP, sqlite3), read without ROS, and captures of the packets of sensors.
//!
//! [`Recording::open`] reads the index and the first seconds, finds out which topics hold the clouds and the poses, and
//! [`Recording::events`] plays the recording from front to back as a registered cloud list. Clouds are `sensor_msgs/PointCloud2` of any layout
//! and Livox `CustomMsg`, or made of the packets of sensors; poses are `nav_msgs/Odometry`, `nav_msgs/Path`, `geometry_msgs/PoseStamped` (also with covariance), the transform
//! tree of `/tf` and `/tf_static`, or a trajectory file with times.
//!
//! ```no_run
//! use voxelastic_io::{OpenOptions, bag::Recording};
//!
//! let recording = Recording::open("drive.mcap", &OpenOptions::default())?;
//! println!("{}", recording.description());
//! for event in recording.events() {
//!     println!("{event:?}");
//! }
//! # Ok::<(), voxelastic_io::Error>(())
//! ```
//!
//! A recording that is truncated or has no index is read as far as it goes; a part that cannot be read is an `Err` item that names it.
//! Formats: wiki.ros.org/Bags/Format/2.0, mcap.dev/spec, the schema of rosbag2's sqlite3 storage; messages as in common_interfaces and
//! livox_ros_driver2.

mod containers;
mod describe;
mod description;
mod graph_nodes;
pub mod live;
mod messages;
mod packet_topics;
mod raw_player;
mod raw_recording;
mod recording;
mod stream;
mod summary;
mod topics;

pub use containers::format::BagFormat;
pub use describe::{describe, is_recording};
pub use description::{KEYFRAME_DISTANCE_M, RecordingDescription};
pub(crate) use messages::fixes::fixes;
pub(crate) use messages::images::{BagImages, images};
pub(crate) use raw_recording::RawRecording;
pub use recording::{Recording, RecordingEvents};
pub use summary::TopicSummary;
