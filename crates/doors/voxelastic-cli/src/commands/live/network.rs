//! Arguments for the network of ROS 2 that a node joins, and for Foxglove.

use crate::args::BodyArgs;
use crate::failure::Failure;
use clap::{Args, ValueEnum};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use voxelastic_ground::Inflation;
use voxelastic_live::link::Link;
use voxelastic_live::node::{Backend, NetworkSetup};
use voxelastic_live::ros::names::Names;
use voxelastic_live::ros::output::GridSettings;

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
    /// Name of the node, and first part of the names of its topics and services; perhaps with a namespace: robot1/mapper
    #[arg(long, value_name = "NAME", default_value = "voxelastic", value_parser = node_name)]
    node: String,
    /// Another name of a topic or a service, or __ns:=NAMESPACE, __node:=NAME; may be given several times. As other nodes have it: --ros-args -r FROM:=TO. Own topics need no ~/ before them, inputs are
    /// points, odom, imu and corrections. In a namespace, topics are looked for in it
    #[arg(short = 'r', long, value_name = "FROM:=TO", value_parser = remap)]
    remap: Vec<String>,
    /// Be a managed node: Nav2's lifecycle manager, or `ros2 lifecycle set`, configures and activates it; before that, scans are not mapped
    #[arg(long, requires = "ros2")]
    lifecycle: bool,
    /// Do not publish the transform from the map to the odometry: somebody else does
    #[arg(long)]
    no_tf: bool,
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
    /// Edge of a cell of the 2-D map that is published, metres [default: the finest voxel of the map]
    #[arg(long, value_name = "M")]
    grid_resolution: Option<f64>,
    #[command(flatten)]
    robot: BodyArgs,
    /// Side of the local costmap around the robot, metres [default: 10]
    #[arg(long, value_name = "M")]
    costmap_size: Option<f64>,
    /// Radius of the largest circle around the middle of the robot within its footprint, metres: nearer to an obstacle it touches it [default: 0.3]
    #[arg(long, value_name = "M")]
    footprint_radius: Option<f64>,
    /// Costs reach this far from obstacles, metres, as with Nav2's inflation layer [default: 0.8, or half a metre more than the footprint's radius]
    #[arg(long, value_name = "M")]
    inflation_radius: Option<f64>,
    /// How fast costs fall beyond the footprint's radius, 1/m [default: 3]
    #[arg(long, value_name = "N")]
    cost_scaling: Option<f64>,
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

    /// What the node is to do, over a link if that is limited.
    ///
    /// # Errors
    /// Remaps that contradict each other; a 2-D map that cannot be made of voxels of `voxel_size` metres.
    pub fn setup(&self, voxel_size: f32, link: Option<Arc<Link>>) -> Result<NetworkSetup, Failure> {
        let names = Names::parse(&self.node, &self.remap).map_err(|problem| Failure::usage(problem, "see `voxelastic live --help`"))?;
        let backend = self.ros2.map(|travels| match travels {
            Travels::Usual => Backend::Usual,
            Travels::Dds => Backend::Dds,
            Travels::Zenoh => Backend::Zenoh,
        });
        let usual = GridSettings::default();
        let radius = self.footprint_radius.unwrap_or(usual.inflation.radius);
        let inflation = Inflation {
            radius,
            reach: self.inflation_radius.unwrap_or(usual.inflation.reach.max(radius + 0.5)),
            falloff: self.cost_scaling.unwrap_or(usual.inflation.falloff),
        };
        let costmap_size = self.costmap_size.unwrap_or(usual.costmap_size);
        let grid = GridSettings { resolution: self.grid_resolution, body: self.robot.body(), inflation, costmap_size, ..usual };
        grid.check(f64::from(voxel_size)).map_err(|problem| Failure::usage(problem.to_string(), problem.remedy()))?;
        Ok(NetworkSetup {
            grid,
            names,
            backend,
            domain: self.domain,
            is_local: self.local,
            use_sim_time: self.use_sim_time,
            transforms: !self.no_tf,
            lifecycle: self.lifecycle,
            foxglove: self.foxglove,
            origins: self.origins(),
            link,
            record: self.record.clone(),
        })
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

/// A name of a node, perhaps with its namespace.
fn node_name(text: &str) -> Result<String, String> {
    Names::parse(text, &[]).map(|_| text.to_owned())
}

fn remap(text: &str) -> Result<String, String> {
    Names::parse("node", &[text.to_owned()]).map(|_| text.to_owned())
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
        assert!(["voxelastic", "_map2", "robot1/mapper"].iter().all(|name| node_name(name).is_ok()));
        assert!(["", "2map", "a/", "a__b", "ä"].iter().all(|name| node_name(name).is_err()));
    }
}
