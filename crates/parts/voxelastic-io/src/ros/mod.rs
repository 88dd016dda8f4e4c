//! Messages of ROS as bytes, written and read without ROS: what recordings hold and what goes over the network.
//!
//! ```
//! use voxelastic_io::ros::{Header, MessageReader, MessageWriter};
//!
//! let header = Header { stamp: 12.5, frame: "map" };
//! let message = MessageWriter::new().header(header).f64s(&[1.0, 2.0, 3.0]).finish();
//! let mut reader = MessageReader::new(&message).unwrap();
//! assert_eq!((reader.u32(), reader.u32(), reader.text().as_deref()), (Some(12), Some(500_000_000), Some("map")));
//! assert_eq!(reader.f64(), Some(1.0));
//! ```

mod definitions;
mod messages;
mod reader;
mod writer;

pub use definitions::definition;
pub use messages::{FieldType, point_cloud, transforms};
pub(crate) use reader::Encoding;
pub use reader::MessageReader;
pub use writer::{CDR_HEADER, Header, MessageWriter};
