//! Where the scans come from: a recording, the topics of a robot, or a sensor.

use super::network::{Network, NetworkSetup};
use super::offers::InputRecording;
use super::positions::Positions;
use crate::feed::Overload;
use crate::ouster::{LIDAR_PORT, OusterAddress, OusterInput};
use crate::replay::{Lateness, Rate, Replay};
use crate::ros::discovery::discover;
use crate::ros::heard::Heard;
use crate::ros::input::{Lost, TopicInput};
use crate::spinning::{SpinningAddress, SpinningInput};
use crate::transport::Transport;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use voxelastic::Cloud;
use voxelastic::event::NodeId;
use voxelastic::mapper::ScanSource;
use voxelastic::sensor::BeamModel;
use voxelastic_io::bag::live::{LiveFrames, LiveTopic};
use voxelastic_io::{OpenOptions, ReadPosition};
use voxelastic_run::keep::Comes;
use voxelastic_run::poses::{Motions, OdometrySetup, OdometryStage};
use voxelastic_run::{Error, Result, Warnings};

/// Where scans are to come from.
pub enum ScansFrom {
    /// A recording, or a folder of scans, that is played. `slam` has poses estimated, even if the data have some.
    Recording {
        /// The recording or folder.
        data: PathBuf,
        /// The speed.
        rate: Rate,
        /// Whether poses are estimated.
        slam: bool,
    },
    /// The topics of a robot; poses are estimated where no topic has them, or with `slam`.
    Topics {
        /// Whether poses are estimated.
        slam: bool,
    },
    /// The packets of an Ouster sensor. Poses are estimated.
    Ouster(OusterAddress),
    /// The packets of a Velodyne, a Hesai or a RoboSense. Poses are estimated.
    Spinning(SpinningAddress),
    /// Anything else, which comes once. Poses are estimated if there is a stage for that.
    Transport(Box<dyn Transport>, Option<Box<OdometryStage>>),
}

impl ScansFrom {
    /// Whether it is a robot, which may deliver nothing for long and does not deliver twice.
    pub(super) fn is_robot(&self) -> bool {
        !matches!(self, Self::Recording { .. })
    }

    /// What it is, as it decides about the bits of the map.
    pub(super) fn name(&self) -> String {
        match self {
            Self::Recording { data, .. } => data.display().to_string(),
            Self::Topics { .. } => "topics".to_owned(),
            Self::Ouster(_) => "ouster".to_owned(),
            Self::Spinning(_) => "lidar".to_owned(),
            Self::Transport(..) => "transport".to_owned(),
        }
    }
}

/// Scans as they come, and what is known about them.
pub struct Source {
    scans: Scans,
    /// Estimates poses, if they come without.
    pub odometry: Option<OdometryStage>,
    /// The sensor's own tables of beams, if known.
    pub sensor: Option<BeamModel>,
    /// The frames of topics.
    pub frames: Option<LiveFrames>,
    /// What comes on which topic.
    pub heard: Option<Heard>,
    lost: Lost,
    lateness: Lateness,
    /// Whether a decoder failed in a way that is a mistake of this program.
    is_broken: Arc<AtomicBool>,
}

/// What delivers scans.
enum Scans {
    /// A recording that is played, and where its reading was after each item.
    Recorded(Box<voxelastic_run::Source>, Rate, Positions),
    /// A robot, whose scans do not come again; none once it has begun.
    Passing(Option<Box<dyn Transport>>),
}

impl Source {
    /// Opens what scans come from. Topics are waited for, and recorded, too, with `recording`; none if `is_stopped` became true before they were there.
    pub fn open(
        from: ScansFrom,
        options: &OpenOptions,
        network: Option<(&mut Network, &NetworkSetup)>,
        recording: Option<&InputRecording>,
        threads: usize,
        is_stopped: &dyn Fn() -> bool,
        warnings: &mut Warnings,
    ) -> Result<Option<Self>> {
        match (from, network) {
            (ScansFrom::Recording { data, rate, slam }, _) => {
                let (input, _) = voxelastic_run::Source::open_decided(&data, options, slam.then_some(true), warnings)?;
                input.description().lines().for_each(|line| tracing::info!("{line}"));
                let (odometry, sensor) = (input.odometry(threads)?, input.sensor());
                Ok(Some(Self::new(Scans::Recorded(Box::new(input), rate, Positions::default()), odometry, sensor)))
            }
            (ScansFrom::Ouster(address), _) => Self::ouster(&address, options, threads).map(Some),
            (ScansFrom::Spinning(address), _) => Self::spinning(&address, options, threads).map(Some),
            (ScansFrom::Transport(transport, odometry), _) => Ok(Some(Self::passing(transport, odometry.map(|stage| *stage), None))),
            (ScansFrom::Topics { slam }, Some((network, setup))) => Self::topics(network, setup, options, slam, recording, threads, is_stopped),
            (ScansFrom::Topics { .. }, None) => Err(Error::usage("topics need a network", "join one, over DDS or Zenoh")),
        }
    }

    fn topics(
        network: &mut Network,
        setup: &NetworkSetup,
        options: &OpenOptions,
        slam: bool,
        recording: Option<&InputRecording>,
        threads: usize,
        is_stopped: &dyn Fn() -> bool,
    ) -> Result<Option<Self>> {
        let names = network.names().clone();
        let found = discover(network.middleware(), &names, options, slam, is_stopped)?;
        let Some((topics, is_raw)) = found else { return Ok(None) };
        if let (true, [_, second, ..]) = (is_raw, topics.clouds()) {
            let problem = format!("poses can be estimated from one topic of clouds, not from {second} besides");
            return Err(Error::usage(problem, "name a topic of poses (--pose-topic), or record the topics and map the recording with both"));
        }
        network.set_transforms(topics.transforms()[0]);
        let topics = if setup.use_sim_time { topics.with_clock() } else { topics };
        if is_raw && !slam {
            tracing::info!("no topic of poses: they are estimated from the scans (--pose-topic names one)");
        }
        topics.description().lines().for_each(|line| tracing::info!("{line}"));
        let tap = |topic: &LiveTopic| recording.map(|recording| recording.tap(topic)).transpose();
        let input = TopicInput::subscribe(network.middleware(), topics, is_raw, options, &tap)
            .map_err(|problem| Error::new(problem.to_string(), "check the network and the names of the topics"))?;
        let odometry = if is_raw { Some(stage(options, threads)?) } else { None };
        let (frames, lost, heard) = (Some(input.frames()), input.lost(), Some(input.heard()));
        Ok(Some(Self { frames, lost, heard, ..Self::passing(Box::new(input), odometry, None) }))
    }

    fn ouster(address: &OusterAddress, options: &OpenOptions, threads: usize) -> Result<Self> {
        let metadata = address.metadata(options.metadata.as_deref())?;
        let port = address.port().or(metadata.lidar_port()).unwrap_or(LIDAR_PORT);
        // Sensors send the packets of their inertial measurement unit to the next port.
        let addresses = [port, port.saturating_add(1)].map(|port| SocketAddr::from(([0, 0, 0, 0], port)));
        let sensor = metadata.model().ok();
        let input = OusterInput::listen(metadata, &addresses, address.host(), options.use_imu).map_err(|problem| {
            let message = format!("cannot listen at the UDP ports {port} and {}: {problem}", port.saturating_add(1));
            Error::new(message, "another program may use them: end it")
        })?;
        tracing::info!("listening at the UDP ports {port} and {}", port.saturating_add(1));
        let odometry = Some(stage(options, threads)?);
        Ok(Self { lost: Lost::of(input.lost()), ..Self::passing(Box::new(input), odometry, sensor) })
    }

    fn spinning(address: &SpinningAddress, options: &OpenOptions, threads: usize) -> Result<Self> {
        let at = SocketAddr::from(([0, 0, 0, 0], address.port));
        let input = SpinningInput::listen(at, address.host()?, options.metadata.clone()).map_err(|problem| {
            let message = format!("cannot listen at the UDP port {}: {problem}", address.port);
            Error::new(message, "another program may use it: end it")
        })?;
        tracing::info!("listening at the UDP port {}", address.port);
        let odometry = Some(stage(options, threads)?);
        Ok(Self { lost: Lost::of(input.lost()), ..Self::passing(Box::new(input), odometry, None) })
    }

    /// What comes once. Poses are estimated if there is an `odometry`.
    fn passing(transport: Box<dyn Transport>, odometry: Option<OdometryStage>, sensor: Option<BeamModel>) -> Self {
        Self::new(Scans::Passing(Some(transport)), odometry, sensor)
    }

    fn new(scans: Scans, odometry: Option<OdometryStage>, sensor: Option<BeamModel>) -> Self {
        let (lost, lateness) = (Lost::default(), Lateness::default());
        Self { scans, odometry, sensor, frames: None, heard: None, lost, lateness, is_broken: Arc::default() }
    }

    /// Whether what comes can be had again.
    pub fn comes(&self) -> Comes {
        if self.recorded().is_some() { Comes::Again } else { Comes::Once }
    }

    /// The recording, if it is one: its scans can be read again.
    pub fn recorded(&self) -> Option<&voxelastic_run::Source> {
        if let Scans::Recorded(input, ..) = &self.scans { Some(input) } else { None }
    }

    /// What delivers scans, once; of a recording, what comes after a position. None if it was stopped before it was read up to there.
    pub fn play(&mut self, from: Option<ReadPosition>, is_stopped: fn() -> bool) -> Option<Box<dyn Transport>> {
        let is_broken = Arc::clone(&self.is_broken);
        match &mut self.scans {
            Scans::Recorded(input, rate, positions) => {
                let mut inputs = match from {
                    Some(from) => input.inputs_from(from, is_stopped)?,
                    None => input.inputs(),
                };
                let positions = positions.clone();
                let replayed = std::iter::from_fn(move || {
                    let next = inputs.next()?;
                    positions.add(inputs.read_position());
                    is_broken.fetch_or(inputs.is_broken(), Ordering::Relaxed);
                    Some(next)
                });
                let replay = Replay::new(Box::new(replayed), *rate);
                self.lateness = replay.lateness();
                Some(Box::new(replay))
            }
            Scans::Passing(transport) => transport.take(),
        }
    }

    /// What happens when scans come too fast.
    pub fn overload(&self) -> Overload {
        match &self.scans {
            Scans::Recorded(_, rate, _) if rate.factor().is_none() => Overload::Wait,
            _ => Overload::NewestWin,
        }
    }

    /// How much later than it was due a scan was read, at most.
    pub fn late(&self) -> Duration {
        self.lateness.most()
    }

    /// Messages that came and were not looked at.
    pub fn lost(&self) -> usize {
        self.lost.count()
    }

    /// Whether a decoder failed in a way that is a mistake of this program.
    pub fn is_broken(&self) -> bool {
        self.is_broken.load(Ordering::Relaxed)
    }

    /// Clouds without a pose.
    pub fn without_pose(&self) -> usize {
        let of_recording = self.recorded().map_or(0, voxelastic_run::Source::without_pose);
        of_recording + self.frames.as_ref().map_or(0, LiveFrames::without_pose)
    }

    /// Reads clouds again, which is possible for recordings only.
    pub fn clouds(&self) -> Box<dyn ScanSource + Send> {
        self.recorded().map_or_else(|| Box::new(Gone) as Box<dyn ScanSource + Send>, voxelastic_run::Source::clouds)
    }

    /// Where the reading of a recording was after each item.
    pub fn positions(&self) -> Option<Positions> {
        if let Scans::Recorded(_, _, positions) = &self.scans { Some(positions.clone()) } else { None }
    }
}

fn stage(options: &OpenOptions, threads: usize) -> Result<OdometryStage> {
    OdometryStage::new(OdometrySetup::of_recording(options), Motions::default(), threads)
}

/// Scans that were not kept.
struct Gone;

impl ScanSource for Gone {
    fn cloud(&mut self, _: NodeId) -> Result<Cloud, Box<dyn std::error::Error + Send + Sync>> {
        Err("the scans of a robot are not kept: record them, and map the recording".into())
    }
}
