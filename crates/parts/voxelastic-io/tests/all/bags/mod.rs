//! Recordings written by other people's software (`write.py`: rosbags, mcap). The fixtures are some of what it wrote; the rest is written
//! anew where Python has the packages (`VOXELASTIC_PYTHON`, default `python3`).

mod drive;
mod fixes;
mod harm;
mod images;
mod message_bag;
mod ouster;
mod packet_topics;
mod packets;
mod robosense;
mod times;
mod two_sensors;
mod written;

use std::path::{Path, PathBuf};

/// A recording in the repository.
fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/all/bags/fixtures").join(name)
}
