//! Voxelastic as a node of ROS 2, without ROS: topics in, topics and services out.
//!
//! | module | contents |
//! | --- | --- |
//! | [`middleware`] | what DDS and Zenoh have in common: subscribe, publish, serve |
//! | `dds`, `zenoh` | the two of them (feature `ros2`) |
//! | `foxglove`, `recorder` | what is published, over Foxglove's protocol and into MCAP files (feature `foxglove`) |
//! | [`input`] | the messages of topics as a transport |
//! | [`output`] | what is published about the map, and when |
//! | [`messages`] | messages as bytes |
//! | [`services`] | requests to the node |
//!
//! Messages are handled as bytes (CDR, by [`voxelastic_io::ros`]): the same bytes go to DDS, to Zenoh and into recordings.

#[cfg(feature = "ros2")]
pub mod dds;
#[cfg(feature = "foxglove")]
pub mod foxglove;
pub mod input;
#[cfg(feature = "ros2")]
mod interfaces;
pub mod messages;
pub mod middleware;
#[cfg(feature = "ros2")]
mod outbox;
pub mod output;
#[cfg(feature = "ros2")]
mod parameters;
#[cfg(feature = "ros2")]
mod raw_message;
#[cfg(feature = "foxglove")]
pub mod recorder;
pub mod services;
#[cfg(feature = "ros2")]
pub mod zenoh;
