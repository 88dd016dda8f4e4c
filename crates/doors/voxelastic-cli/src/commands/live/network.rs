//! Arguments for the network of ROS 2 that a node joins, and for Foxglove.

use clap::{Args, ValueEnum};
use std::net::SocketAddr;
use std::path::PathBuf;
use voxelastic_live::node::{Backend, NetworkSetup};

/// Arguments for ROS 2.
#[derive(Debug, Args)]
#[command(next_help_heading = "ROS 2")]
pub struct NetworkArgs {
    /// Be a node of ROS 2: publish the map, offer services, and take the scans from topics unless --from names a recording. Without a value over DDS, or over
    /// what RMW_IMPLEMENTATION says. Needs a program with the cargo feature `ros2`, or the wheel
    #[arg(long, value_enum, value_name = "dds|zenoh", num_args = 0..=1, require_equals = true, default_missing_value = "usual")]
    ros2: Option<Travels>,
    /// The domain [default: ROS_DOMAIN_ID, or 0]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(0..=232), requires = "ros2")]
    domain: Option<u16>,
    /// Name of the node, and first part of the names of its topics and services
    #[arg(long, value_name = "NAME", default_value = "voxelastic", value_parser = node_name)]
    node: String,
    /// Over DDS, talk to programs on this machine only, as with ROS_LOCALHOST_ONLY=1 or ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
    #[arg(long, requires = "ros2")]
    local: bool,
    /// Time is that of the topic /clock, as a simulation publishes it: it may be faster or slower, stand still, and begin again
    #[arg(long, requires = "ros2")]
    use_sim_time: bool,
    /// Serve what is published to Foxglove, with or without ROS 2. Without an address on this machine only, at 127.0.0.1:8765
    #[arg(long, value_name = "ADDRESS:PORT", num_args = 0..=1, require_equals = true, default_missing_value = "127.0.0.1:8765")]
    foxglove: Option<SocketAddr>,
    /// Let web pages of this origin, too, read what --view and --foxglove serve, such as https://viewer.example, and answer to its name. May be given several times
    /// [default: at Foxglove's port https://app.foxglove.dev]
    #[arg(long, value_name = "ORIGIN", value_parser = origin)]
    allow_origin: Vec<String>,
    /// Record the messages that come in, for `voxelastic map` and to be played again; and what is published, in a second file: FILE-map.mcap
    #[arg(long, value_name = "FILE.mcap", requires = "ros2")]
    record: Option<PathBuf>,
}

impl NetworkArgs {
    /// Whether anything is published.
    pub fn publishes(&self) -> bool {
        self.ros2.is_some() || self.foxglove.is_some()
    }

    /// Origins whose pages may read what is served.
    pub fn origins(&self) -> Vec<String> {
        self.allow_origin.clone()
    }

    /// What the node is to do.
    pub fn setup(&self) -> NetworkSetup {
        let backend = self.ros2.map(|travels| match travels {
            Travels::Usual => Backend::Usual,
            Travels::Dds => Backend::Dds,
            Travels::Zenoh => Backend::Zenoh,
        });
        NetworkSetup {
            node: self.node.clone(),
            backend,
            domain: self.domain,
            is_local: self.local,
            use_sim_time: self.use_sim_time,
            foxglove: self.foxglove,
            origins: self.origins(),
            record: self.record.clone(),
        }
    }
}

/// What messages travel by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Travels {
    /// As RMW_IMPLEMENTATION says; DDS by default
    #[value(hide = true)]
    Usual,
    /// The network of most ROS 2 systems
    Dds,
    /// As rmw_zenoh: through a router at localhost:7447, or as ZENOH_SESSION_CONFIG_URI and ZENOH_CONFIG_OVERRIDE say
    Zenoh,
}

/// As browsers send it: a scheme and a host, perhaps a port, nothing after it.
fn origin(text: &str) -> Result<String, String> {
    let host = text.split_once("://").filter(|(scheme, _)| scheme.bytes().all(|byte| byte.is_ascii_alphanumeric())).map(|(_, host)| host);
    let is_host = |host: &str| host.bytes().all(|byte| byte.is_ascii_alphanumeric() || b".-:[]".contains(&byte));
    if host.is_some_and(is_host) {
        Ok(text.to_owned())
    } else {
        Err("must be as browsers send it, such as https://viewer.example or http://localhost:8080".to_owned())
    }
}

/// Names of nodes are made of letters, digits and single underscores.
fn node_name(text: &str) -> Result<String, String> {
    let is_word = text.chars().all(|c| c.is_ascii_alphanumeric() || c == '_') && !text.contains("__");
    let begins = text.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_');
    if is_word && begins { Ok(text.to_owned()) } else { Err("must be letters, digits and single underscores, and begin with a letter".to_owned()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn origins_are_checked() {
        assert!(["https://viewer.example", "http://[::1]:80", "file://"].iter().all(|text| origin(text).is_ok()));
        assert!(["viewer.example", "https://viewer.example/", "*", "https://a b", "null"].iter().all(|text| origin(text).is_err()));
    }

    #[test]
    fn names_of_nodes_are_checked() {
        assert!(["voxelastic", "_map2"].iter().all(|name| node_name(name).is_ok()));
        assert!(["", "2map", "a/b", "a__b", "ä"].iter().all(|name| node_name(name).is_err()));
    }
}
