//! Captures: the packets of a sensor in a `.pcap` or `.pcapng` file, as a network sniffer or the maker's program records them.
//!
//! [`Pcap`] reads the datagrams. Sensors that turn ([`velodyne`], [`hesai`], [`robosense`]) share everything but the layout of their packets: each is a [`SpinningPackets`],
//! which turns packets into returns, and a [`TurnAssembler`] makes scans of them. Ouster's packets have the columns of a fixed image and need the sensor's own
//! description, see [`crate::ouster`]. Which sensor it is is recognised from the packets.

mod clock;
mod datagrams;
mod date;
mod files;
mod frames;
mod head_turn;
mod hesai;
mod kind;
mod live;
mod packet_sensor;
mod recognise;
mod robosense;
mod source_choice;
mod spinning;
mod spinning_capture;
mod stream;
mod turn_assembler;
mod velodyne;

pub(crate) use datagrams::Pcap;
pub(crate) use files::find_angles;
pub(crate) use frames::{MAGICS, PCAPNG};
pub(crate) use kind::CaptureKind;
pub(crate) use live::SpinningStream;
pub(crate) use packet_sensor::{PacketScans, PacketSensor};
pub use source_choice::SensorPacket;
pub(crate) use source_choice::{Fate, SourceChoice};
pub(crate) use stream::{CapturedScans, message};
