//! Live mapping: inputs as they come, and the mapper that nothing else may keep waiting.
//!
//! | module | contents |
//! | --- | --- |
//! | [`transport`] | where inputs come from: the trait that a robot's middleware or a recording implements |
//! | [`replay`] | a recording as a transport, at its own or another rate |
//! | [`ouster`], [`spinning`] | the packets of an Ouster sensor, and of Velodyne's, Hesai's and RoboSense's, as a transport |
//! | [`node`] | all of it together: what comes is mapped, told, published and kept |
//! | [`ros`] | topics and services of ROS 2 |
//! | [`feed`] | the thread that a transport runs on, and the bounded queue between it and the mapper |
//! | [`link`] | a link of limited rate to those who listen, such as a radio |
//! | [`planner`] | where to go next, on a thread with a copy of the map |
//! | [`publisher`] | from the mapper to the scene: what changed, and which tiles of the surface |
//! | [`scene`] | what viewers show, as messages ([`wire`]): the latest of each thing |
//! | [`viewer`] | the server of the page that shows it |
//! | [`editor`] | the page on which a saved map is mended by hand |
//!
//! A [`Transport`](transport::Transport) runs on a thread of its own and fills a queue. The mapper's thread takes from it. When scans come faster than
//! they can be mapped, the newest win, by the rule of [`feed::Overload`], and those left out are counted. After each event a [`Publisher`](publisher::Publisher)
//! puts what changed into a [`Scene`](scene::Scene), and never waits for those who look at it.

pub mod editor;
pub mod feed;
#[cfg(feature = "fuzzing")]
pub mod fuzzing;
mod http;
pub mod link;
mod near_scans;
pub mod node;
pub mod ouster;
mod page;
pub mod planner;
pub mod publisher;
pub mod replay;
pub mod ros;
pub mod scene;
pub mod spinning;
mod tile_thread;
mod tiles;
pub mod transport;
mod udp;
pub mod viewer;
pub mod wire;
mod worker;
