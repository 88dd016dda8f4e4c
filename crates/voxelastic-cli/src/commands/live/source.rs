//! Where the scans come from: a recording, or the topics of a robot.

use super::network::Network;
use super::offers::InputRecording;
use super::ouster_address::{LIDAR_PORT, OusterAddress};
use super::rate::Rate;
use crate::data::{DataArgs, ReadingArgs};
use crate::elastic::ElasticArgs;
use crate::failure::Failure;
use crate::input::{Input, OdometryStage};
use crate::interrupt;
use std::error::Error;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;
use voxelastic::Cloud;
use voxelastic::event::NodeId;
use voxelastic::mapper::ScanSource;
use voxelastic::sensor::BeamModel;
use voxelastic_io::bag::live::{LiveFrames, LiveTopic};
use voxelastic_live::feed::Overload;
use voxelastic_live::ouster::OusterInput;
use voxelastic_live::replay::{Lateness, Replay};
use voxelastic_live::ros::input::{Lost, TopicInput, discover};
use voxelastic_live::transport::Transport;

/// Scans as they come, and what is known about them.
pub struct Source {
    transport: Box<dyn Transport>,
    overload: Overload,
    /// Estimates poses, if they come without.
    pub odometry: Option<OdometryStage>,
    /// The sensor's own tables of beams, if known.
    pub sensor: Option<BeamModel>,
    /// The recording, if it is one.
    recording: Option<Input>,
    lateness: Lateness,
    /// The frames of topics.
    pub frames: Option<LiveFrames>,
    lost: Lost,
    is_broken: Arc<AtomicBool>,
}

impl Source {
    /// A recording, or a folder of scans, that is played.
    pub fn recording(data: &DataArgs, rate: Rate, slam: bool, elastic: ElasticArgs, threads: usize) -> anyhow::Result<Self> {
        let input = Input::open(data, false, slam, elastic.pose_kind())?;
        input.description().lines().for_each(|line| tracing::info!("{line}"));
        let is_broken = Arc::new(AtomicBool::new(false));
        let replay = Replay::new(input.incoming(Arc::clone(&is_broken)), rate.factor());
        Ok(Self {
            lateness: replay.lateness(),
            transport: Box::new(replay),
            overload: if rate.factor().is_some() { Overload::NewestWin } else { Overload::Wait },
            odometry: input.odometry(threads)?,
            sensor: input.sensor(),
            recording: Some(input),
            frames: None,
            lost: Lost::default(),
            is_broken,
        })
    }

    /// The topics of a robot, which are recorded, too, with `recording`. Waits until they are there; none if an interrupt came before.
    pub fn topics(
        network: &mut Network,
        reading: &ReadingArgs,
        slam: bool,
        recording: Option<&InputRecording>,
        threads: usize,
    ) -> anyhow::Result<Option<Self>> {
        let options = DataArgs::at(Path::new("topics"), reading).options(false);
        let node = network.node().to_owned();
        let is_own =
            move |name: &str| name.strip_prefix('/').and_then(|name| name.strip_prefix(node.as_str())).is_some_and(|rest| rest.starts_with('/'));
        let found = discover(network.middleware(), &options, slam, &is_own, &interrupt::requested)?;
        let Some((topics, is_raw)) = found else { return Ok(None) };
        if is_raw && !slam {
            tracing::info!("no topic of poses: they are estimated from the scans (--pose-topic names one)");
        }
        topics.description().lines().for_each(|line| tracing::info!("{line}"));
        let tap = |topic: &LiveTopic| recording.map(|recording| recording.tap(topic)).transpose();
        let input = TopicInput::subscribe(network.middleware(), topics, is_raw, &options, &tap)
            .map_err(|problem| Failure::new(problem.to_string(), "check the network and the names of the topics"))?;
        Ok(Some(Self {
            frames: Some(input.frames()),
            lost: input.lost(),
            transport: Box::new(input),
            overload: Overload::NewestWin,
            odometry: if is_raw { Some(OdometryStage::of_recording(&options, threads)?) } else { None },
            sensor: None,
            recording: None,
            lateness: Lateness::default(),
            is_broken: Arc::default(),
        }))
    }

    /// An Ouster sensor, whose packets come here. Poses are estimated.
    pub fn ouster(address: &OusterAddress, reading: &ReadingArgs, threads: usize) -> anyhow::Result<Self> {
        let options = DataArgs::at(Path::new("ouster"), reading).options(false);
        let metadata = address.metadata(options.metadata.as_deref())?;
        let port = address.port().or(metadata.lidar_port()).unwrap_or(LIDAR_PORT);
        // Sensors send the packets of their inertial measurement unit to the next port.
        let addresses = [port, port.saturating_add(1)].map(|port| SocketAddr::from(([0, 0, 0, 0], port)));
        let sensor = metadata.model().ok();
        let input = OusterInput::listen(metadata, &addresses, address.host(), options.use_imu).map_err(|problem| {
            Failure::new(
                format!("cannot listen at the UDP ports {port} and {}: {problem}", port.saturating_add(1)),
                "another program may use them: end it",
            )
        })?;
        tracing::info!("listening at the UDP ports {port} and {}", port.saturating_add(1));
        Ok(Self {
            lost: Lost::of(input.lost()),
            transport: Box::new(input),
            overload: Overload::NewestWin,
            odometry: Some(OdometryStage::of_recording(&options, threads)?),
            sensor,
            recording: None,
            lateness: Lateness::default(),
            frames: None,
            is_broken: Arc::default(),
        })
    }

    /// What delivers scans, what estimates their poses, and what remains to be known about them meanwhile.
    pub fn start(self) -> (Box<dyn Transport>, Option<OdometryStage>, Started) {
        let Self { overload, recording, lateness, frames, lost, is_broken, .. } = self;
        (self.transport, self.odometry, Started { overload, recording, lateness, frames, lost, is_broken })
    }
}

/// A source whose scans are on their way.
pub struct Started {
    /// What happens when they come too fast.
    pub overload: Overload,
    recording: Option<Input>,
    lateness: Lateness,
    frames: Option<LiveFrames>,
    lost: Lost,
    /// Whether a decoder failed in a way that is a mistake of this program.
    pub is_broken: Arc<AtomicBool>,
}

impl Started {
    /// How much later than it was due a scan was read, at most.
    pub fn late(&self) -> Duration {
        self.lateness.most()
    }

    /// Messages that came and were not looked at.
    pub fn lost(&self) -> usize {
        self.lost.count()
    }

    /// Clouds without a pose.
    pub fn without_pose(&self) -> usize {
        let of_recording = self.recording.as_ref().map_or(0, Input::without_pose);
        of_recording + self.frames.as_ref().map_or(0, LiveFrames::without_pose)
    }

    /// Reads clouds again, which is possible for recordings only.
    pub fn clouds(&self) -> Box<dyn ScanSource + Send> {
        self.recording.as_ref().map_or_else(|| Box::new(Gone) as Box<dyn ScanSource + Send>, Input::clouds)
    }
}

/// Scans that were not kept.
struct Gone;

impl ScanSource for Gone {
    fn cloud(&mut self, _: NodeId) -> Result<Cloud, Box<dyn Error + Send + Sync>> {
        Err("the scans of a robot are not kept: record them, and map the recording".into())
    }
}
