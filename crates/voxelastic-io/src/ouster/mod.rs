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
mod pcap;
mod sensor_metadata;
mod stream;

pub use capture::Capture;
pub use metadata_file::find_metadata;
pub(crate) use pcap::MAGICS;
pub(crate) use stream::CaptureStream;
