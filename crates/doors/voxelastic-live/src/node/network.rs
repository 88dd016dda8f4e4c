//! The network of ROS 2 that a node joins.

use crate::link::Link;
use crate::ros::managed;
use crate::ros::middleware::{Handle, Middleware, MiddlewareError, NodeOptions, Parameter};
use crate::ros::names::Names;
use crate::ros::output::GridSettings;
use crate::ros::services::RequestSender;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use voxelastic::Settings;
use voxelastic_run::{Error, Result};

/// What a node publishes, and where scans may come from.
#[derive(Clone, Debug)]
pub struct NetworkSetup {
    /// Names of the node, its topics and its services.
    pub names: Names,
    /// What messages of ROS 2 travel by; none for a node that is in no network.
    pub backend: Option<Backend>,
    /// The domain; none for that of `ROS_DOMAIN_ID`, or 0.
    pub domain: Option<u16>,
    /// Whether only programs on this machine are talked to, over DDS.
    pub is_local: bool,
    /// Whether time is that of the topic `/clock`.
    pub use_sim_time: bool,
    /// Whether the transform from the map to the odometry is published.
    pub transforms: bool,
    /// What the 2-D map is made for.
    pub grid: GridSettings,
    /// Whether it is a managed node: it maps once it is configured and activated.
    pub lifecycle: bool,
    /// Where what is published is served to Foxglove.
    pub foxglove: Option<SocketAddr>,
    /// Origins whose pages may read what is served there; without any, Foxglove's own.
    pub origins: Vec<String>,
    /// What it is published over, where that limits what goes out.
    pub link: Option<Arc<Link>>,
    /// The MCAP file into which what comes in is recorded.
    pub record: Option<PathBuf>,
}

/// What messages travel by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Backend {
    /// As `RMW_IMPLEMENTATION` says; DDS by default.
    Usual,
    /// The network of most ROS 2 systems.
    Dds,
    /// As rmw_zenoh: through a router.
    Zenoh,
}

/// A node.
pub struct Network {
    middleware: Box<dyn Middleware>,
    names: Names,
}

impl Network {
    /// Joins the network, if one was asked for.
    pub fn join(setup: &NetworkSetup, settings: &Settings) -> Result<Option<Self>> {
        let Some(backend) = setup.backend else { return Ok(None) };
        if cfg!(not(feature = "ros2")) {
            return Err(Error::new(
                "this program was built without ROS 2",
                "install it with ROS 2: cargo install --path crates/doors/voxelastic-cli --features ros2; the wheel for Python has it",
            ));
        }
        let says = |name: &str, value: &str| std::env::var(name).is_ok_and(|text| text.eq_ignore_ascii_case(value));
        let domain = std::env::var("ROS_DOMAIN_ID").ok().and_then(|text| text.trim().parse().ok());
        let options = NodeOptions {
            name: setup.names.node().to_owned(),
            namespace: setup.names.namespace().to_owned(),
            domain: setup.domain.or(domain).unwrap_or(0),
            local_only: setup.is_local || says("ROS_LOCALHOST_ONLY", "1") || says("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"),
            for_cyclone: says("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp"),
            parameters: parameters(settings, &setup.grid, setup.use_sim_time),
        };
        let is_zenoh = backend == Backend::Zenoh || backend == Backend::Usual && says("RMW_IMPLEMENTATION", "rmw_zenoh_cpp");
        let middleware = open(&options, is_zenoh).map_err(|problem| {
            let remedy = if is_zenoh {
                "see `voxelastic live --help` for what configures Zenoh"
            } else {
                "check the network interfaces; --local uses this machine only"
            };
            Error::new(problem.to_string(), remedy)
        })?;
        tracing::info!("node {} in domain {} over {}", setup.names.full(), options.domain, middleware.name());
        Ok(Some(Self { middleware, names: setup.names.clone() }))
    }

    /// Its names.
    pub fn names(&self) -> &Names {
        &self.names
    }

    /// Transforms are published, and heard, on another topic.
    pub fn set_transforms(&mut self, topic: &str) {
        self.names = self.names.clone().with("/tf", topic);
    }

    /// Offers the services of a managed node, which are there as long as what it returns.
    pub fn offer_states(&mut self, requests: &RequestSender) -> Result<Vec<Handle>> {
        let offered = managed::offer(self.middleware.as_mut(), &self.names, requests);
        offered.map_err(|problem| Error::new(problem.to_string(), "another name of the node may help: --node"))
    }

    /// What messages travel by.
    pub fn middleware(&mut self) -> &mut dyn Middleware {
        self.middleware.as_mut()
    }
}

#[cfg(feature = "ros2")]
fn open(options: &NodeOptions, is_zenoh: bool) -> Result<Box<dyn Middleware>, MiddlewareError> {
    use crate::ros::{dds::Dds, zenoh::Zenoh};
    if is_zenoh { Ok(Box::new(Zenoh::open(options)?)) } else { Ok(Box::new(Dds::open(options)?)) }
}

#[cfg(not(feature = "ros2"))]
fn open(_: &NodeOptions, _: bool) -> Result<Box<dyn Middleware>, MiddlewareError> {
    Err(MiddlewareError::new("cannot join a network", "this program was built without ROS 2"))
}

/// The settings as parameters, what the 2-D map is made for, and that which all nodes have.
fn parameters(settings: &Settings, grid: &GridSettings, use_sim_time: bool) -> Vec<(String, Parameter)> {
    let value = |text: String| match (text.parse(), text.parse(), text.parse()) {
        (Ok(value), ..) => Parameter::Bool(value),
        (_, Ok(value), _) => Parameter::Integer(value),
        (_, _, Ok(value)) => Parameter::Number(value),
        _ => Parameter::Text(text),
    };
    let of_grid = grid.pairs(f64::from(settings.voxel_size)).map(|(key, value)| (key.to_owned(), Parameter::Number(value)));
    let simulated = ("use_sim_time".to_owned(), Parameter::Bool(use_sim_time));
    settings.pairs().into_iter().map(|(key, text)| (key.to_owned(), value(text))).chain(of_grid).chain([simulated]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_are_parameters_of_their_types() {
        let all = parameters(&Settings::default(), &GridSettings::default(), true);
        let of = |key: &str| all.iter().find(|(name, _)| name == key).map(|(_, value)| value.clone());
        assert!(matches!(of("voxel_size"), Some(Parameter::Number(_))) && matches!(of("threads"), Some(Parameter::Integer(0))));
        assert!(matches!(of("field"), Some(Parameter::Text(_))), "{all:?}");
        assert_eq!((of("grid_resolution"), of("body_height")), (of("voxel_size"), Some(Parameter::Number(1.0))));
        assert_eq!(of("use_sim_time"), Some(Parameter::Bool(true)));
    }
}
