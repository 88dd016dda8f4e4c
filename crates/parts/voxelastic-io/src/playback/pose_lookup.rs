//! The lidar's pose at a time, from any of the sources of poses that recordings have.

use super::message_stream::SensorMessage;
use crate::motion::{LONGEST_GAP_S, PoseTrack, TransformTree, is_map, tell_registered};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use voxelastic::Pose;
use voxelastic::geometry::{PoseChange, PoseExt};

/// Where the poses come from.
pub(crate) enum PoseSource {
    /// From a file: all are known from the start.
    File(PoseTrack),
    /// From messages of a topic, with the frames of the last one: that which the poses are in, and that which they are of.
    Topic { track: PoseTrack, parent: String, child: String },
    /// From the transform tree.
    Transforms,
}

impl PoseSource {
    /// Messages of a topic that have not come yet.
    pub(crate) fn of_topic() -> Self {
        Self::Topic { track: PoseTrack::default(), parent: String::new(), child: String::new() }
    }
}

/// Where the sensors are on the vehicle, as far as it is known before anything is played.
#[derive(Clone, Debug, Default)]
pub(crate) struct SensorMounts {
    /// Pose of each lidar in the vehicle's frame, if the user gave it.
    pub(crate) given: Vec<Option<Pose>>,
    /// The frame of the first lidar's clouds, where there are several lidars.
    pub(crate) first_frame: String,
    /// Whether messages come from a robot: nothing comes in order, and transforms may change.
    pub(crate) is_live: bool,
    /// Whether it was said where the first lidar is taken to be. A recording is looked at before it is played.
    pub(crate) has_said: Arc<AtomicBool>,
}

/// A lidar whose place on what the poses are of has changed.
#[derive(Clone, Debug)]
pub(crate) struct Remounted {
    pub(crate) sensor: u16,
    pub(crate) frame: String,
    /// The new place in the frame of the lidar at the old one.
    pub(crate) t_old_new: Pose,
}

/// Places of a lidar that differ by less, metres and radians, are the same.
const SAME_PLACE: [f64; 2] = [1e-3, 1e-3];

impl SensorMounts {
    /// Of one sensor.
    pub(crate) fn one(t_base_lidar: Option<Pose>) -> Self {
        Self { given: vec![t_base_lidar], ..Self::default() }
    }

    /// Whether something about the place of the first lidar is still to be said; once.
    fn must_say(&self) -> bool {
        !self.has_said.swap(true, Ordering::Relaxed)
    }

    fn given(&self, sensor: u16) -> Option<Pose> {
        self.given.get(usize::from(sensor)).copied().flatten()
    }
}

/// Collects poses and transforms as they arrive and gives the lidar's pose.
pub(crate) struct PoseLookup {
    source: PoseSource,
    tree: TransformTree,
    mounts: SensorMounts,
    /// Pose of each lidar in the frame of the poses, once it is known: by topic, and by the frame of its clouds, as several lidars may publish to one topic.
    t_child_lidar: BTreeMap<(u16, String), Pose>,
    /// What to read otherwise of poses that come.
    change: PoseChange,
    /// How far in time a pose may be from its scan, seconds.
    tolerance_s: f64,
    /// Times of the first and the last pose of a topic or a file so far, seconds.
    span: Option<[f64; 2]>,
}

impl PoseLookup {
    pub(crate) fn new(source: PoseSource, mounts: SensorMounts, change: PoseChange, tolerance_s: f64) -> Self {
        let span = if let PoseSource::File(track) = &source { track.span() } else { None };
        Self { source, tree: TransformTree::default(), mounts, t_child_lidar: BTreeMap::new(), change, tolerance_s, span }
    }

    /// Adds a pose or transform; other messages are ignored.
    pub(super) fn add(&mut self, message: SensorMessage) {
        match message {
            SensorMessage::Transform { time, parent, child, pose, is_fixed } => self.tree.add(&parent, &child, time, pose, is_fixed),
            SensorMessage::Pose { time, parent: within, child: of, pose, .. } => {
                if let PoseSource::Topic { track, parent, child } = &mut self.source {
                    let time = time - self.change.seconds;
                    track.add(time, self.change.apply(&pose));
                    self.span = Some(self.span.map_or([time; 2], |[first, last]| [first.min(time), last.max(time)]));
                    (*parent, *child) = (within, of);
                }
            }
            SensorMessage::ClockJump => self.forget(),
            SensorMessage::Cloud(_) | SensorMessage::Corrected(_) | SensorMessage::Imu(_) | SensorMessage::Other => {}
        }
    }

    /// Forgets all poses; fixed transforms stay.
    fn forget(&mut self) {
        self.tree.remove_moving();
        if let PoseSource::Topic { track, .. } = &mut self.source {
            *track = PoseTrack::default();
        }
    }

    /// Times of the first and the last pose of a topic or a file so far, seconds.
    pub(super) fn span(&self) -> Option<[f64; 2]> {
        self.span
    }

    /// Time up to which the poses of `frame` are known; `None` if there are none yet.
    pub(super) fn known_until(&self, frame: &str) -> Option<f64> {
        match &self.source {
            PoseSource::File(_) => Some(f64::INFINITY),
            PoseSource::Topic { track, .. } => track.newest(),
            PoseSource::Transforms => self.tree.newest(frame).map(|newest| newest - self.change.seconds),
        }
    }

    /// Pose of a lidar, whose frame is `frame`, at a time.
    pub(super) fn pose_at(&mut self, time: f64, frame: &str, sensor: u16) -> Option<Pose> {
        let tolerance = self.tolerance_s;
        let pose = match &self.source {
            // A frame that nothing moves is on no robot: its tree is not connected with that of the poses.
            PoseSource::Transforms if !self.tree.moves(frame) => return None,
            PoseSource::Transforms => return self.tree.in_root(frame, time + self.change.seconds, tolerance),
            PoseSource::File(track) | PoseSource::Topic { track, .. } => track.at(time, LONGEST_GAP_S, tolerance)?,
        };
        Some(pose * self.mounting(frame, sensor)?)
    }

    /// Why a lidar has no pose, if its frame is not connected with frames that move: with the trees, as far as they are known.
    pub(super) fn unconnected(&self, frame: &str) -> Option<String> {
        let is_apart = matches!(self.source, PoseSource::Transforms) && !self.tree.moves(frame);
        is_apart.then(|| format!("nothing in /tf leads from {frame} to a frame that moves; the frames are: {}", self.tree.drawing()))
    }

    /// Whether clouds of this frame are in the one that the poses are in: an odometry has moved their points already.
    pub(super) fn is_registered(&self, frame: &str) -> bool {
        matches!(&self.source, PoseSource::Topic { parent, child, .. } if parent == frame && is_map(parent, child))
    }

    /// Whether it is known where the lidar is on what the poses are of. The transform that says so may come after the first scan: over a network, nothing comes in order.
    pub(super) fn is_mounted(&self, frame: &str, sensor: u16) -> bool {
        let PoseSource::Topic { child, .. } = &self.source else { return true };
        let is_further = sensor > 0 && !self.mounts.is_live;
        let is_known = is_further || self.known(frame, sensor).is_some() || self.mounts.given(sensor).is_some() || self.is_registered(frame);
        is_known || child.is_empty() || child == frame || self.tree.fixed(child, frame).is_some()
    }

    /// What is missing before a lidar of a robot has a pose: a transform, with the frames that are known.
    pub(super) fn missing(&self, frame: &str, sensor: u16) -> Option<String> {
        if let PoseSource::Topic { child, .. } = &self.source
            && self.mounts.is_live
            && !self.is_mounted(frame, sensor)
        {
            return Some(format!("no fixed transform leads from {child} to {frame}; the transforms are: {}", self.tree.drawing()));
        }
        self.unconnected(frame)
    }

    /// Takes the places of lidars that fixed transforms say now, where that is another one than before. Those that the user gave stay.
    pub(super) fn remount(&mut self) -> Vec<Remounted> {
        let PoseSource::Topic { child, .. } = &self.source else { return Vec::new() };
        let mut changed = Vec::new();
        for ((sensor, frame), known) in &mut self.t_child_lidar {
            let Some(now) = self.tree.fixed(child, frame).filter(|_| self.mounts.given(*sensor).is_none() && child != frame) else { continue };
            if now.translation_distance(known) > SAME_PLACE[0] || now.rotation_distance(known) > SAME_PLACE[1] {
                changed.push(Remounted { sensor: *sensor, frame: frame.clone(), t_old_new: known.inv_mul(&now) });
                *known = now;
            }
        }
        changed
    }

    fn known(&self, frame: &str, sensor: u16) -> Option<Pose> {
        self.t_child_lidar.get(&(sensor, frame.to_owned())).copied()
    }

    /// The frame of a topic's first cloud, and where its lidar is.
    fn first_of(&self, sensor: u16) -> Option<(&str, Pose)> {
        self.t_child_lidar.iter().find(|((of, _), _)| *of == sensor).map(|((_, frame), pose)| (frame.as_str(), *pose))
    }

    /// Pose of a lidar in the frame of the poses; `None` if it is a further one and nothing says where it is.
    fn mounting(&mut self, frame: &str, sensor: u16) -> Option<Pose> {
        if let Some(known) = self.known(frame, sensor) {
            return Some(known);
        }
        if let Some((first, t_child_first)) = self.first_of(sensor) {
            // Another lidar on the same topic.
            let found = t_child_first * self.tree.fixed(first, frame)?;
            tracing::info!("clouds of {frame} come on the topic of {first}, and are placed by the fixed transforms between the two");
            self.t_child_lidar.insert((sensor, frame.to_owned()), found);
            return Some(found);
        }
        let child = if let PoseSource::Topic { child, .. } = &self.source { child.clone() } else { String::new() };
        let found = if self.is_registered(frame) {
            if self.mounts.must_say() {
                tell_registered(frame, &child);
            }
            self.mounts.given(sensor).unwrap_or_default()
        } else if sensor == 0 {
            mounting(&self.tree, &child, frame, &self.mounts)
        } else if let Some(given) = self.mounts.given(sensor) {
            given
        } else if let Some(found) = self.tree.fixed(&child, frame).filter(|_| self.mounts.is_live) {
            found
        } else {
            let first = self.mounts.first_frame.clone();
            self.mounting(&first, 0)? * self.tree.fixed(&first, frame)?
        };
        self.t_child_lidar.insert((sensor, frame.to_owned()), found);
        Some(found)
    }

    /// Pose of a lidar in the frame that corrected poses refer to. With a transform tree that frame is unknown: that of the first lidar is assumed.
    pub(super) fn t_child_lidar(&self, frame: &str, sensor: u16) -> Pose {
        if let Some(known) = self.known(frame, sensor).or(self.mounts.given(sensor)) {
            return known;
        }
        let first = self.first_of(0).map(|(_, pose)| pose).or(self.mounts.given(0)).unwrap_or_default();
        if sensor == 0 { first } else { first * self.tree.fixed(&self.mounts.first_frame, frame).unwrap_or_default() }
    }

    /// Removes poses older than `time`.
    pub(super) fn remove_before(&mut self, time: f64) {
        self.tree.remove_before(time);
        if let PoseSource::Topic { track, .. } = &mut self.source {
            track.remove_before(time);
        }
    }
}

/// Pose of the first lidar in the frame that the poses are of: as the user says, else by the fixed transforms, else the identity.
fn mounting(tree: &TransformTree, child: &str, lidar: &str, mounts: &SensorMounts) -> Pose {
    if let Some(pose) = mounts.given(0) {
        return pose;
    }
    if child.is_empty() || child == lidar {
        return Pose::identity();
    }
    tree.fixed(child, lidar).unwrap_or_else(|| {
        if mounts.must_say() {
            tracing::warn!(
                "no fixed transform leads from {child} to {lidar}: the poses are taken as those of the lidar (--t-base-lidar says otherwise)"
            );
        }
        Pose::identity()
    })
}
