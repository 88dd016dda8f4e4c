//! Playback of recordings: messages by time become registered scans.
//!
//! A recording is read once, from front to back. Scans wait until the poses around them have arrived, which SLAM systems publish late; then
//! the keyframes among them are decoded. Memory does not grow with the recording's length.

mod clock_watch;
mod corrections;
mod message_stream;
mod playback_log;
mod player;
mod pose_lookup;
mod reread_clouds;
mod robot_mounts;
mod selection;

pub(crate) use clock_watch::ClockWatch;
pub(crate) use corrections::{Corrections, read_track};
pub(crate) use message_stream::{CloudMessage, MessageStream, OpenStream, SensorMessage};
pub(crate) use playback_log::{DeliveredScan, PlaybackLog};
pub use player::Polled;
pub(crate) use player::{Player, PlayerOptions};
pub(crate) use pose_lookup::{PoseSource, SensorMounts};
pub(crate) use reread_clouds::CloudRereader;
pub(crate) use selection::Selection;
