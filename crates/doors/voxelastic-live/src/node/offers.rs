//! What a node offers: topics and services, to a network, to Foxglove and to files.

use super::network::{Network, NetworkSetup};
use crate::ros::initial_pose;
use crate::ros::middleware::{Handle, MiddlewareError};
#[cfg(feature = "foxglove")]
use crate::ros::middleware::{Sink, TopicProfile};
use crate::ros::names::Names;
use crate::ros::output::{OutputOptions, Outputs};
use crate::ros::services::{RequestSender, offer};
use std::net::SocketAddr;
use std::path::Path;
use voxelastic_io::bag::live::LiveTopic;
use voxelastic_run::{Error, Result};

/// What gets the messages of a topic.
type Record = Box<dyn Fn(&[u8]) + Send + Sync>;

/// What a node offers.
pub struct Offers {
    /// What it publishes.
    pub outputs: Outputs,
    /// Services and servers, which end with this.
    held: Vec<Handle>,
}

impl Offers {
    /// What the setup asks for; none if that is nothing. Requests go to `requests`. A robot that `explores` has topics for that, too.
    pub fn announce(setup: &NetworkSetup, network: Option<&mut Network>, requests: &RequestSender, explores: bool) -> Result<Option<Self>> {
        if network.is_none() && setup.foxglove.is_none() {
            return Ok(None);
        }
        let options =
            OutputOptions { explores, transforms: setup.transforms, grid: setup.grid, link: setup.link.clone(), ..OutputOptions::default() };
        let mut offers = Self { outputs: Outputs::new(options), held: Vec::new() };
        if let Some(network) = network {
            let announced = offers.add_network(network, requests);
            announced.map_err(|problem| Error::new(problem.to_string(), "another name of the node may help: --node"))?;
        }
        if let Some(address) = setup.foxglove {
            let remedy = "another program may use that port: name another address, or port 0 for one that is free";
            offers.add_foxglove(address, setup).map_err(|problem| Error::new(problem.to_string(), remedy))?;
        }
        if let Some(file) = &setup.record {
            offers
                .add_recording(&recording_of_outputs(file), &setup.names)
                .map_err(|problem| Error::new(problem.to_string(), "name a file that does not exist"))?;
        }
        Ok(Some(offers))
    }

    fn add_network(&mut self, network: &mut Network, requests: &RequestSender) -> Result<(), MiddlewareError> {
        let names = network.names().clone();
        self.outputs.add(network.middleware(), &names)?;
        self.held.extend(offer(network.middleware(), &names, requests)?);
        self.held.push(initial_pose::listen(network.middleware(), &names, requests)?);
        Ok(())
    }

    #[cfg(feature = "foxglove")]
    fn add_foxglove(&mut self, address: SocketAddr, setup: &NetworkSetup) -> Result<(), MiddlewareError> {
        use crate::ros::foxglove::{APP, FoxgloveServer};
        let origins = if setup.origins.is_empty() { vec![APP.to_owned()] } else { setup.origins.clone() };
        let server = FoxgloveServer::start(setup.names.node(), address, origins)?;
        self.outputs.add_sinks(&setup.names, |profile| server.advertise(profile))?;
        tracing::info!("Foxglove: open a connection to ws://{}", server.address());
        if !server.address().ip().is_loopback() {
            tracing::warn!("everyone who reaches {} can read what is published; nobody can change anything", server.address());
        }
        self.held.push(Handle::new(server));
        Ok(())
    }

    #[cfg(feature = "foxglove")]
    fn add_recording(&mut self, file: &Path, names: &Names) -> Result<(), MiddlewareError> {
        let recorder = crate::ros::recorder::Recorder::create(file)?;
        // Players show grids, and few apply what changes in them: each is recorded as a whole.
        let is_recorded = |profile: &TopicProfile| profile.kind != "map_msgs/msg/OccupancyGridUpdate";
        self.outputs.add_sinks(names, |profile| {
            let recorded = is_recorded(profile).then(|| recorder.topic(&profile.name, &profile.kind)).transpose()?;
            Ok(recorded.map_or_else(|| Box::new(Nobody) as Box<dyn Sink>, |topic| Box::new(topic)))
        })?;
        tracing::info!("what is published is recorded in {}", file.display());
        self.held.push(Handle::new(recorder));
        Ok(())
    }

    #[cfg(not(feature = "foxglove"))]
    fn add_foxglove(&mut self, _: SocketAddr, _: &NetworkSetup) -> Result<(), MiddlewareError> {
        Err(without())
    }

    #[cfg(not(feature = "foxglove"))]
    fn add_recording(&mut self, _: &Path, _: &Names) -> Result<(), MiddlewareError> {
        Err(without())
    }
}

/// Nobody listens to a topic.
#[cfg(feature = "foxglove")]
struct Nobody;

#[cfg(feature = "foxglove")]
impl Sink for Nobody {
    fn publish(&mut self, _: &[u8]) -> Result<(), MiddlewareError> {
        Ok(())
    }

    fn subscribers(&self) -> usize {
        0
    }
}

/// A recording of what comes in.
pub struct InputRecording {
    #[cfg(feature = "foxglove")]
    recorder: crate::ros::recorder::Recorder,
}

impl InputRecording {
    /// Begins the file.
    pub fn begin(file: &Path) -> Result<Self> {
        let begun = Self::create(file).map_err(|problem| Error::new(problem.to_string(), "name a file that does not exist"))?;
        tracing::info!("what comes in is recorded in {}", file.display());
        Ok(begun)
    }

    #[cfg(feature = "foxglove")]
    fn create(file: &Path) -> Result<Self, MiddlewareError> {
        Ok(Self { recorder: crate::ros::recorder::Recorder::create(file)? })
    }

    #[cfg(not(feature = "foxglove"))]
    fn create(_: &Path) -> Result<Self, MiddlewareError> {
        Err(without())
    }

    /// What records a topic.
    #[cfg(feature = "foxglove")]
    pub fn tap(&self, topic: &LiveTopic) -> Result<Record, MiddlewareError> {
        let topic = self.recorder.topic(&topic.name, &topic.kind)?;
        Ok(Box::new(move |message| topic.record(message)))
    }

    /// What records a topic.
    #[cfg(not(feature = "foxglove"))]
    pub fn tap(&self, _: &LiveTopic) -> Result<Record, MiddlewareError> {
        Err(without())
    }
}

#[cfg(not(feature = "foxglove"))]
fn without() -> MiddlewareError {
    MiddlewareError::new("cannot serve Foxglove or record", "this program was built without them (cargo feature `foxglove`)")
}

/// `drive-map.mcap` for `drive.mcap`.
fn recording_of_outputs(file: &Path) -> std::path::PathBuf {
    let mut name = file.file_stem().unwrap_or_default().to_owned();
    name.push("-map.mcap");
    file.with_file_name(name)
}

#[cfg(test)]
mod tests {
    #[test]
    fn what_is_published_is_recorded_next_to_what_comes_in() {
        assert_eq!(super::recording_of_outputs("a/drive.mcap".as_ref()), std::path::Path::new("a/drive-map.mcap"));
    }
}
