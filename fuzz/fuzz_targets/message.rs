#![no_main]

use voxelastic_fuzz::{message, play_with};
use voxelastic_io::OpenOptions;
use voxelastic_io::dataset::Keyframing;

/// Types of messages that are read; a seed begins with the place of its type, and an upper-case letter stands for ROS 2's encoding.
const KINDS: [&str; 7] = [
    "sensor_msgs/msg/PointCloud2",
    "livox_ros_driver2/msg/CustomMsg",
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "nav_msgs/msg/Path",
    "tf2_msgs/msg/TFMessage",
];
/// Places of the types that are clouds.
const CLOUDS: usize = 2;

/// A letter for type and encoding, a message.
fn read(data: &[u8]) {
    let Some((letter, data)) = data.split_first() else { return };
    let kind = usize::from(letter.to_ascii_lowercase().wrapping_sub(b'a')) % KINDS.len();
    let encoding = if letter.is_ascii_uppercase() { "cdr" } else { "ros1" };
    let bag = message::bag(KINDS[kind], encoding, data);
    // Any pose will do, however far off in time.
    let mut options = OpenOptions { keyframing: Some(Keyframing::All), time_tolerance_s: 1e12, ..OpenOptions::default() };
    if kind < CLOUDS {
        options.cloud_topic = Some(message::TOPIC.into());
        options.poses = Some(message::trajectory());
    } else {
        options.cloud_topic = Some(message::CLOUDS.into());
        options.pose_topic = Some(message::TOPIC.into());
    }
    play_with(&bag, "mcap", &options);
}

libfuzzer_sys::fuzz_target!(|data: &[u8]| read(data));
