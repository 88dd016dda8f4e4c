//! Where scans are pulled from: a folder or a recording, with poses or without.

mod hold_out;
mod inputs;
mod pair_picture;
mod pose_check;
mod raw;
mod sample;
mod times_check;

pub use hold_out::HoldOut;
pub use inputs::Inputs;
pub use pair_picture::draw_pair;
pub use pose_check::{PosesCheck, pose_flags, pose_problem};
pub use raw::RawSource;
pub use sample::{Examination, Sample, SampledCloud};
pub use times_check::check_undistorted;
pub use voxelastic_slam::pose_check::{CheckScan, Verdict};

use crate::poses::{OdometrySetup, OdometryStage};
use crate::{Error, Result};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicUsize;
use voxelastic::Motion;
use voxelastic::event::NodeId;
use voxelastic::mapper::ScanSource;
use voxelastic::sensor::BeamModel;
use voxelastic_io::source::Source as RegisteredSource;
use voxelastic_io::{OpenOptions, ReadPosition, source};

/// Scans with poses, or raw ones.
pub enum Source {
    /// With the poses of a SLAM system.
    Registered(Box<RegisteredSource>),
    /// Without: odometry gives the poses.
    Raw(Box<RawSource>),
}

impl Source {
    /// Opens a folder or a recording: with its poses, or raw if it has none or `slam` is true. Poses that `options` name must be there, and all must be if
    /// `slam` is false.
    ///
    /// # Errors
    /// When it cannot be read, or lacks what was asked for.
    pub fn open(path: &Path, options: &OpenOptions, slam: Option<bool>) -> Result<Self> {
        let named = names_poses(options);
        if slam == Some(true) {
            if let Some(what) = named {
                return Err(Error::usage(format!("the poses are to be estimated, and {what} are named"), "do without one of the two"));
            }
            return Ok(Self::Raw(Box::new(RawSource::open(path, options)?)));
        }
        match source::open(path, options) {
            Ok(source) => Ok(Self::Registered(Box::new(source))),
            Err(voxelastic_io::Error::NoPoses { path: place, .. }) if slam.is_none() && named.is_none() && place == path => {
                tracing::info!("no poses in {}: they are estimated from the scans", path.display());
                Ok(Self::Raw(Box::new(RawSource::open(path, options)?)))
            }
            Err(problem) => Err(problem.into()),
        }
    }

    /// Whether the poses are estimated.
    pub fn is_raw(&self) -> bool {
        matches!(self, Self::Raw(_))
    }

    /// What was found, in a few lines.
    pub fn description(&self) -> String {
        match self {
            Self::Registered(source) => source.description(),
            Self::Raw(raw) => raw.description(),
        }
    }

    /// Number of scans, if it is known before they are read.
    pub fn scans(&self) -> Option<usize> {
        match self {
            Self::Registered(source) => source.scans(),
            Self::Raw(raw) => raw.scans(),
        }
    }

    /// How much of a recording has been played, 0 to 1, if known.
    pub fn progress(&self) -> Option<f64> {
        match self {
            Self::Registered(source) => source.progress(),
            Self::Raw(_) => None,
        }
    }

    /// The sensor's own tables of beams, if the data contain them.
    pub fn sensor(&self) -> Option<BeamModel> {
        match self {
            Self::Registered(source) => source.sensor(),
            Self::Raw(raw) => raw.sensor(),
        }
    }

    /// Clouds without a pose, as far as known.
    pub fn without_pose(&self) -> usize {
        match self {
            Self::Registered(source) => source.without_pose(),
            Self::Raw(_) => 0,
        }
    }

    /// Takes no more than the first `most` scans.
    pub fn limit(&mut self, most: usize) {
        match self {
            Self::Registered(source) => source.limit(most),
            Self::Raw(raw) => raw.limit(most),
        }
    }

    /// Leaves out the held-out scans; the returned counter grows with each of them.
    pub fn remove_held_out(&mut self, hold_out: HoldOut) -> Arc<AtomicUsize> {
        match self {
            Self::Registered(source) => hold_out.remove_held_out(source),
            Self::Raw(raw) => raw.remove_held_out(hold_out),
        }
    }

    /// All that comes, from the beginning.
    pub fn inputs(&self) -> Inputs {
        match self {
            Self::Registered(source) => Inputs::registered(source.events()),
            Self::Raw(raw) => Inputs::raw(raw.iter(None)),
        }
    }

    /// What comes after that which an earlier process has taken; of a recording, that is read again. None if `is_stopped` becomes true meanwhile.
    pub fn inputs_from(&self, position: ReadPosition, is_stopped: impl Fn() -> bool) -> Option<Inputs> {
        let items = position.items_to_skip();
        if items > 0 {
            tracing::info!("reading the recording again up to where the run was");
        }
        let mut inputs = match self {
            Self::Registered(source) => Inputs::registered(source.events_from(position)),
            Self::Raw(raw) => Inputs::raw(raw.iter(Some(&position))),
        };
        (0..items).all(|_| !is_stopped() && inputs.next().is_some()).then_some(inputs)
    }

    /// A number that differs, as a rule, for other data.
    pub fn fingerprint(&self) -> u64 {
        match self {
            Self::Registered(source) => source.fingerprint(),
            Self::Raw(raw) => raw.fingerprint(),
        }
    }

    /// Takes over how the lidar moved during sweeps that an earlier process has registered.
    pub fn know_motions(&self, motions: impl IntoIterator<Item = (NodeId, Motion)>) {
        if let Self::Raw(raw) = self {
            raw.know_motions(motions);
        }
    }

    /// How raw scans are registered; none for scans with poses.
    pub fn odometry_setup(&self) -> Option<&OdometrySetup> {
        match self {
            Self::Registered(_) => None,
            Self::Raw(raw) => Some(raw.setup()),
        }
    }

    /// What registers raw scans, on `threads` threads; none for scans with poses.
    ///
    /// # Errors
    /// When its threads cannot be started.
    pub fn odometry(&self, threads: usize) -> Result<Option<OdometryStage>> {
        match self {
            Self::Registered(_) => Ok(None),
            Self::Raw(raw) => raw.stage(threads).map(Some),
        }
    }

    /// Reads clouds again that [`inputs`](Self::inputs) delivered.
    pub fn clouds(&self) -> Box<dyn ScanSource + Send> {
        match self {
            Self::Registered(source) => source.clouds(),
            Self::Raw(raw) => raw.clouds(),
        }
    }
}

/// What of the options is about poses, if anything is. Of several sensors, their places say where they are on each other, with poses and without.
fn names_poses(options: &OpenOptions) -> Option<&'static str> {
    let is_one_sensor = options.more_sensors.is_empty() && options.more_folders.is_empty();
    let given = [
        ("poses", options.poses.is_some()),
        ("a graph", options.graph.is_some()),
        ("another reading of poses", !options.pose_change.is_none()),
        ("a topic of poses", options.pose_topic.is_some()),
        ("a topic of corrections", options.correction_topic.is_some()),
        ("the place of the lidar on the vehicle", options.t_base_lidar.is_some() && is_one_sensor),
    ];
    given.into_iter().find(|(_, is_given)| *is_given).map(|(what, _)| what)
}
