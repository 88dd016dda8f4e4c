//! Voxelastic as a node of ROS 2, without ROS: topics in, topics and services out.
//!
//! | module | contents |
//! | --- | --- |
//! | [`middleware`] | what DDS and Zenoh have in common: subscribe, publish, serve |
//! | `dds`, `zenoh` | the two of them (feature `ros2`) |
//! | `foxglove`, `recorder` | what is published, over Foxglove's protocol and into MCAP files (feature `foxglove`) |
//! | [`discovery`] | which topics of a network are a robot's |
//! | [`names`] | namespaces and remaps, as ROS 2 has them |
//! | [`input`], [`heard`] | the messages of topics as a transport; how many came, and when |
//! | [`output`] | what is published about the map, and when |
//! | [`messages`] | messages as bytes |
//! | [`services`], [`managed`], [`lifecycle`] | requests to the node, and to one that is led through its states |
//!
//! Messages are handled as bytes (CDR, by [`voxelastic_io::ros`]): the same bytes go to DDS, to Zenoh and into recordings.

#[cfg(feature = "ros2")]
pub mod dds;
pub mod discovery;
#[cfg(feature = "foxglove")]
pub mod foxglove;
pub mod heard;
pub mod initial_pose;
pub mod input;
#[cfg(feature = "ros2")]
mod interfaces;
pub mod lifecycle;
pub mod managed;
pub mod messages;
pub mod middleware;
pub mod names;
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
