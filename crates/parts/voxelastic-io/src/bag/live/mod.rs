//! Topics of a robot that runs: which of them to subscribe to, and what comes from them as scans.
//!
//! The messages are those of ROS 2, serialised as CDR; which middleware brings them does not matter. They are treated as those of a recording: scans wait for
//! the poses around them, transforms are looked up in time. So the same messages, recorded, give the same scans and poses.
//!
//! ```
//! use std::sync::mpsc::sync_channel;
//! use voxelastic_io::OpenOptions;
//! use voxelastic_io::bag::live::{LiveEvents, LiveTopics, Polled};
//!
//! let there = [("/points", "sensor_msgs/msg/PointCloud2"), ("/odom", "nav_msgs/msg/Odometry")].map(|(name, kind)| (name.to_owned(), kind.to_owned()));
//! let options = OpenOptions::default();
//! let topics = LiveTopics::choose("ROS 2", &there, false, &options)?;
//! assert_eq!(topics.subscriptions()[0].name, "/points");
//! // A middleware sends each message with the position of its topic in `subscriptions`.
//! let (sender, messages) = sync_channel(64);
//! sender.send((0, b"not a cloud".to_vec())).unwrap();
//! drop(sender);
//! let mut events = LiveEvents::new(topics, messages, &options);
//! assert!(matches!(events.poll(), Polled::Item(Err(_))));
//! # Ok::<(), voxelastic_io::Error>(())
//! ```

mod choice;
mod frames;
#[cfg(test)]
mod mount_tests;
mod scans;
mod stream;
#[cfg(test)]
mod tests;

pub use crate::capture::SensorPacket;
pub use crate::playback::Polled;
pub use choice::{LiveTopic, LiveTopics};
pub use frames::{LiveFrames, Reported};
pub use scans::{LiveEvents, LiveScans};

/// Messages as they come: the position of the topic in [`LiveTopics::subscriptions`], and the message with its CDR header.
pub type LiveMessages = std::sync::mpsc::Receiver<(usize, Vec<u8>)>;
