//! Ouster captures: the sensor's UDP packets in a `.pcap`, with its metadata in a `.json` beside it.
//!
//! [`Capture`] turns packets into organised clouds in the sensor frame (Ouster's sensor coordinate frame), destaggered: a row of the cloud is
//! a beam, a column is vertical, and each point has the time of its firing. Packet profiles are legacy, single and dual return, and low
//! data rate. `voxelastic map CAPTURE.pcap --poses slam.tum` maps it, with poses in the sensor's clock.
//!
//! The geometry is that of the firmware user manual (section "Lidar range to XYZ"), the packets those of the section "Lidar data packet
//! format"; the tests compare both with `ouster-sdk`.

mod capture;
mod metadata_file;
mod packet;
mod packet_stream;
mod scan_assembler;
mod sensor_metadata;

use crate::Result;
use crate::capture::Pcap;
pub use capture::Capture;
pub(crate) use capture::FRAME;
pub use metadata_file::find_metadata;
pub(crate) use packet_stream::PacketStream;
pub(crate) use scan_assembler::ScanAssembler;
pub use sensor_metadata::SensorMetadata;
use std::path::Path;

/// The contents of the UDP datagrams in a capture, in order, as the sensor sent them.
///
/// # Errors
/// [`Error::Content`](crate::Error::Content) if it is no capture; [`Error::Io`](crate::Error::Io).
pub fn datagrams(capture: impl AsRef<Path>) -> Result<impl Iterator<Item = Result<Vec<u8>>>> {
    let mut pcap = Pcap::open(capture.as_ref())?;
    Ok(std::iter::from_fn(move || pcap.next().map(|datagram| datagram.map(|datagram| datagram.payload))))
}
