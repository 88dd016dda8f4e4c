//! Reading clouds of a recording a second time, to rebuild submaps.

use super::message_stream::{MessageStream, OpenStream, SensorMessage};
use super::playback_log::{DeliveredScan, PlaybackLog};
use crate::motion::take_back;
use std::error::Error;
use std::sync::Arc;
use voxelastic::Cloud;
use voxelastic::event::NodeId;
use voxelastic::mapper::ScanSource;

/// Reads clouds again by their nodes. Nodes requested in the order of the recording take one pass over it.
pub(crate) struct CloudRereader {
    open: OpenStream,
    log: Arc<PlaybackLog>,
    /// The stream, and the index of its next cloud.
    stream: Option<(Box<dyn MessageStream>, u64)>,
}

impl CloudRereader {
    pub(crate) fn new(open: OpenStream, log: Arc<PlaybackLog>) -> Self {
        Self { open, log, stream: None }
    }
}

impl ScanSource for CloudRereader {
    fn cloud(&mut self, node: NodeId) -> Result<Cloud, Box<dyn Error + Send + Sync>> {
        let DeliveredScan { index, motion, moved_by } = self.log.delivered(node).ok_or("no scan of the recording belongs to it")?;
        let (mut stream, mut next) = match self.stream.take() {
            Some((stream, next)) if next <= index => (stream, next),
            _ => ((self.open)()?, 0),
        };
        // Damaged parts were reported when the recording was read first.
        while let Some(message) = stream.next() {
            let Ok(SensorMessage::Cloud(cloud)) = message else { continue };
            next += 1;
            if next > index {
                let decoded = (cloud.decode)()?;
                self.stream = Some((stream, next));
                let mut read = Cloud { motion, sensor: cloud.sensor, ..decoded.relative_to(cloud.time, cloud.sweep) };
                moved_by.iter().for_each(|t_map_lidar| take_back(&mut read, t_map_lidar));
                return Ok(read);
            }
        }
        Err("the recording ends before it".into())
    }
}
