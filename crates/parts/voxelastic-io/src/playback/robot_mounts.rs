//! Where the lidars of a robot are on it: scans are not mapped before that is known, and those that were mapped are moved when it changes.

use super::playback_log::PlaybackLog;
use super::pose_lookup::{PoseLookup, Remounted};
use crate::scan_list::NODES_OF_SENSOR;
use std::collections::BTreeMap;
use voxelastic::Pose;
use voxelastic::event::{Event, NodeId};

/// It is said what is missing after so long, seconds: transforms need a moment to come.
const MOMENT_S: f64 = 1.0;
/// Scans are kept for so long while it is missing, seconds; after that they are left out until it comes.
const PATIENCE_S: f64 = 6.0;

/// What is known about the lidars of a robot.
#[derive(Debug, Default)]
pub(super) struct RobotMounts {
    /// After so many seconds the poses are taken for those of the lidar; none: never.
    timeout_s: Option<f64>,
    /// Since when the place of each lidar is missing, seconds of the stream.
    missing: BTreeMap<(u16, String), f64>,
    /// Scans that were delivered, each where it is in the map.
    delivered: BTreeMap<NodeId, Pose>,
    has_said: bool,
}

impl RobotMounts {
    pub(super) fn new(timeout_s: Option<f64>) -> Self {
        Self { timeout_s, ..Self::default() }
    }

    /// A cloud has come: looks whether it is known where its lidar is, and says what is missing after a while. False if the cloud need not be kept.
    pub(super) fn look(&mut self, poses: &PoseLookup, (frame, sensor): (&str, u16), now: f64, log: &PlaybackLog) -> bool {
        let key = (sensor, frame.to_owned());
        let Some(what) = poses.missing(frame, sensor).filter(|_| !self.is_assumed(&key, now)) else {
            if self.missing.remove(&key).is_some() && self.missing.is_empty() {
                log.set_waits_for(None);
            }
            return true;
        };
        let since = *self.missing.entry(key).or_insert(now);
        if now - since < MOMENT_S {
            return true;
        }
        if !std::mem::replace(&mut self.has_said, true) {
            tracing::error!("scans wait: {what}; publish the transform, or say where the lidar is: --t-base-lidar");
        }
        log.set_waits_for(Some(what));
        now - since < PATIENCE_S
    }

    /// Whether a lidar's place has been missing for so long that it is assumed.
    fn is_assumed(&self, key: &(u16, String), now: f64) -> bool {
        self.timeout_s.zip(self.missing.get(key)).is_some_and(|(timeout, since)| now - since >= timeout)
    }

    /// Whether a scan of a lidar may be mapped now.
    pub(super) fn may_map(&self, poses: &PoseLookup, (frame, sensor): (&str, u16), now: f64) -> bool {
        poses.is_mounted(frame, sensor) || self.is_assumed(&(sensor, frame.to_owned()), now)
    }

    /// Notes where a scan is in the map.
    pub(super) fn note(&mut self, node: NodeId, t_map_lidar: Pose) {
        self.delivered.insert(node, t_map_lidar);
    }

    /// Notes where corrections have put scans.
    pub(super) fn correct(&mut self, poses: &[(NodeId, Pose)]) {
        for (node, pose) in poses {
            self.delivered.entry(*node).and_modify(|known| *known = *pose);
        }
    }

    /// The scans of a lidar whose place on the robot has changed, each where it is now; none if it has none.
    pub(super) fn moved(&mut self, change: &Remounted, log: &PlaybackLog) -> Option<Event> {
        let (distance, angle) = (change.t_old_new.translation.vector.norm(), change.t_old_new.rotation.angle().to_degrees());
        let mut poses = Vec::new();
        for (node, pose) in self.delivered.iter_mut().filter(|(node, _)| sensor_of(**node) == change.sensor) {
            *pose *= change.t_old_new;
            poses.push((*node, *pose));
        }
        let frame = &change.frame;
        let note = format!(
            "the transform that says where {frame} is on the robot changed by {distance:.3} m and {angle:.1} degrees: it is taken, and {} scans are moved by it",
            poses.len()
        );
        tracing::warn!("{note}");
        log.add_note(note);
        (!poses.is_empty()).then_some(Event::PoseUpdate(poses))
    }
}

/// The sensor that a node is of.
pub(super) fn sensor_of(node: NodeId) -> u16 {
    u16::try_from(node / NODES_OF_SENSOR).unwrap_or(u16::MAX)
}
