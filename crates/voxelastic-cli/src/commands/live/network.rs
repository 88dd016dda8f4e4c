//! The network of ROS 2 that a node joins.

use crate::failure::Failure;
use clap::{Args, ValueEnum};
use std::net::SocketAddr;
use std::path::PathBuf;
use voxelastic::Settings;
use voxelastic_live::ros::middleware::{Middleware, MiddlewareError, NodeOptions, Parameter};

/// Arguments for ROS 2.
#[derive(Debug, Args)]
#[command(next_help_heading = "ROS 2")]
pub struct NetworkArgs {
    /// Be a node of ROS 2: publish the map, offer services, and take the scans from topics unless --from names a recording. Without a value over DDS, or over
    /// what RMW_IMPLEMENTATION says. Needs a program with the cargo feature `ros2`, or the wheel
    #[arg(long, value_enum, value_name = "dds|zenoh", num_args = 0..=1, require_equals = true, default_missing_value = "usual")]
    pub ros2: Option<Backend>,
    /// The domain [default: ROS_DOMAIN_ID, or 0]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(0..=232), requires = "ros2")]
    domain: Option<u16>,
    /// Name of the node, and first part of the names of its topics and services
    #[arg(long, value_name = "NAME", default_value = "voxelastic", value_parser = node_name)]
    pub node: String,
    /// Over DDS, talk to programs on this machine only, as with ROS_LOCALHOST_ONLY=1 or ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
    #[arg(long, requires = "ros2")]
    local: bool,
    /// Time is that of the topic /clock, as a simulation publishes it: it may be faster or slower, stand still, and begin again
    #[arg(long, requires = "ros2")]
    pub use_sim_time: bool,
    /// Serve what is published to Foxglove, with or without ROS 2. Without an address on this machine only, at 127.0.0.1:8765
    #[arg(long, value_name = "ADDRESS:PORT", num_args = 0..=1, require_equals = true, default_missing_value = "127.0.0.1:8765")]
    pub foxglove: Option<SocketAddr>,
    /// Record the messages that come in, for `voxelastic map` and to be played again; and what is published, in a second file: FILE-map.mcap
    #[arg(long, value_name = "FILE.mcap", requires = "ros2")]
    pub record: Option<PathBuf>,
}

impl NetworkArgs {
    /// Whether anything is published.
    pub fn publishes(&self) -> bool {
        self.ros2.is_some() || self.foxglove.is_some()
    }
}

/// What messages travel by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Backend {
    /// As RMW_IMPLEMENTATION says; DDS by default
    #[value(hide = true)]
    Usual,
    /// The network of most ROS 2 systems
    Dds,
    /// As rmw_zenoh: through a router at localhost:7447, or as ZENOH_SESSION_CONFIG_URI and ZENOH_CONFIG_OVERRIDE say
    Zenoh,
}

/// Names of nodes are made of letters, digits and single underscores.
fn node_name(text: &str) -> Result<String, String> {
    let is_word = text.chars().all(|c| c.is_ascii_alphanumeric() || c == '_') && !text.contains("__");
    let begins = text.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_');
    if is_word && begins { Ok(text.to_owned()) } else { Err("must be letters, digits and single underscores, and begin with a letter".to_owned()) }
}

/// A node.
pub struct Network {
    middleware: Box<dyn Middleware>,
    node: String,
}

impl Network {
    /// Joins the network, if one was asked for.
    pub fn join(args: &NetworkArgs, settings: &Settings) -> anyhow::Result<Option<Self>> {
        let Some(backend) = args.ros2 else { return Ok(None) };
        if cfg!(not(feature = "ros2")) {
            return Err(Failure::new(
                "this program was built without ROS 2",
                "install it with ROS 2: cargo install --path crates/voxelastic-cli --features ros2; the wheel for Python has it",
            )
            .into());
        }
        let says = |name: &str, value: &str| std::env::var(name).is_ok_and(|text| text.eq_ignore_ascii_case(value));
        let domain = std::env::var("ROS_DOMAIN_ID").ok().and_then(|text| text.trim().parse().ok());
        let options = NodeOptions {
            name: args.node.clone(),
            domain: args.domain.or(domain).unwrap_or(0),
            local_only: args.local || says("ROS_LOCALHOST_ONLY", "1") || says("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"),
            for_cyclone: says("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp"),
            parameters: parameters(settings, args.use_sim_time),
        };
        let is_zenoh = backend == Backend::Zenoh || backend == Backend::Usual && says("RMW_IMPLEMENTATION", "rmw_zenoh_cpp");
        let middleware = open(&options, is_zenoh).map_err(|problem| {
            let remedy = if is_zenoh {
                "see `voxelastic live --help` for what configures Zenoh"
            } else {
                "check the network interfaces; --local uses this machine only"
            };
            Failure::new(problem.to_string(), remedy)
        })?;
        tracing::info!("node /{} in domain {} over {}", options.name, options.domain, middleware.name());
        Ok(Some(Self { middleware, node: options.name }))
    }

    /// Its name.
    pub fn node(&self) -> &str {
        &self.node
    }

    /// What messages travel by.
    pub fn middleware(&mut self) -> &mut dyn Middleware {
        self.middleware.as_mut()
    }
}

#[cfg(feature = "ros2")]
fn open(options: &NodeOptions, is_zenoh: bool) -> Result<Box<dyn Middleware>, MiddlewareError> {
    use voxelastic_live::ros::{dds::Dds, zenoh::Zenoh};
    if is_zenoh { Ok(Box::new(Zenoh::open(options)?)) } else { Ok(Box::new(Dds::open(options)?)) }
}

#[cfg(not(feature = "ros2"))]
fn open(_: &NodeOptions, _: bool) -> Result<Box<dyn Middleware>, MiddlewareError> {
    Err(MiddlewareError::new("cannot join a network", "this program was built without ROS 2"))
}

/// The settings as parameters, and that which all nodes have.
fn parameters(settings: &Settings, use_sim_time: bool) -> Vec<(String, Parameter)> {
    let value = |text: String| match (text.parse(), text.parse(), text.parse()) {
        (Ok(value), ..) => Parameter::Bool(value),
        (_, Ok(value), _) => Parameter::Integer(value),
        (_, _, Ok(value)) => Parameter::Number(value),
        _ => Parameter::Text(text),
    };
    let simulated = ("use_sim_time".to_owned(), Parameter::Bool(use_sim_time));
    settings.pairs().into_iter().map(|(key, text)| (key.to_owned(), value(text))).chain([simulated]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_nodes_are_checked() {
        assert!(["voxelastic", "_map2"].iter().all(|name| node_name(name).is_ok()));
        assert!(["", "2map", "a/b", "a__b", "ä"].iter().all(|name| node_name(name).is_err()));
    }

    #[test]
    fn settings_are_parameters_of_their_types() {
        let all = parameters(&Settings::default(), true);
        let of = |key: &str| all.iter().find(|(name, _)| name == key).map(|(_, value)| value.clone());
        assert!(matches!(of("voxel_size"), Some(Parameter::Number(_))) && matches!(of("threads"), Some(Parameter::Integer(0))));
        assert!(matches!(of("field"), Some(Parameter::Text(_))), "{all:?}");
        assert_eq!(of("use_sim_time"), Some(Parameter::Bool(true)));
    }
}
