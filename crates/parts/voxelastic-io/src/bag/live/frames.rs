//! The frames that messages are in, for those who publish poses of the map.

use crate::motion::TransformTree;
use crate::playback::PlaybackLog;
use std::collections::{BTreeSet, HashMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use voxelastic::Pose;
use voxelastic::event::NodeId;

/// The pose that a scan came with, before any correction.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Reported {
    /// The scan's node.
    pub node: NodeId,
    /// Time stamp of the scan, seconds.
    pub time: f64,
    /// Pose of the lidar in the frame that the poses came in.
    pub t_odom_lidar: Pose,
}

/// What is known about frames so far; shared with the thread that reads messages.
#[derive(Clone, Debug, Default)]
pub struct LiveFrames {
    names: Arc<Mutex<Names>>,
    log: Arc<PlaybackLog>,
}

#[derive(Debug, Default)]
struct Names {
    /// Of the clouds.
    lidar: Option<String>,
    /// That the poses of a topic are in, and that which they are of.
    poses: Option<String>,
    body: Option<String>,
    tree: TransformTree,
    /// Of a simulation, seconds.
    clock: Option<f64>,
    /// Stamps of the transforms that were published here, by the frame that they place.
    published: HashMap<String, VecDeque<f64>>,
    /// A transform of such a frame that somebody else has published, and when it came.
    rival: Option<([String; 2], Instant)>,
}

impl Names {
    /// The frame that clouds are mapped in: their own, or, where an odometry has moved them into the frame of its poses, that of the body.
    fn lidar(&self) -> Option<&String> {
        let body = self.body.as_ref().filter(|body| !body.is_empty() && self.lidar == self.poses);
        body.or(self.lidar.as_ref())
    }
}

/// A transform that is this much older than the last of its frame, seconds, is of a clock that went back.
const LARGEST_DISORDER_S: f64 = 1.0;
/// Transforms that move are kept for so long, seconds.
const MEMORY_S: f64 = 10.0;
/// Stamps of transforms that were published here that are kept.
const MOST_STAMPS: usize = 256;
/// Who else publishes a transform has stopped if nothing came for so long.
const RIVAL: Duration = Duration::from_secs(5);

impl LiveFrames {
    pub(super) fn new(log: Arc<PlaybackLog>) -> Self {
        Self { names: Arc::default(), log }
    }

    fn names(&self) -> MutexGuard<'_, Names> {
        self.names.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn set_lidar(&self, frame: &str) {
        let mut names = self.names();
        if names.lidar.as_deref() != Some(frame) {
            names.lidar = Some(frame.to_owned());
        }
    }

    pub(super) fn set_poses(&self, parent: &str, child: &str) {
        let mut names = self.names();
        let Names { poses, body, .. } = &mut *names;
        for (known, name) in [(poses, parent), (body, child)] {
            if known.as_deref() != Some(name) {
                *known = Some(name.to_owned());
            }
        }
    }

    pub(super) fn add_transform(&self, [parent, child]: [&str; 2], time: f64, pose: Pose, is_fixed: bool) {
        let mut names = self.names();
        if !is_fixed && names.tree.is_later(child, time, LARGEST_DISORDER_S) {
            names.tree.remove_moving();
        }
        names.tree.add(parent, child, time, pose, is_fixed);
        if !is_fixed {
            names.tree.remove_before(time - MEMORY_S);
        }
    }

    /// Whether a transform is of a frame that is placed here. Where the message is not from here, somebody else places the frame, too: the map does not hang on that.
    pub(super) fn is_published_here(&self, [parent, child]: [&str; 2], time: f64) -> bool {
        let mut names = self.names();
        let Some(stamps) = names.published.get(child) else { return false };
        if !stamps.iter().any(|stamp| (stamp - time).abs() < 1e-6) {
            names.rival = Some(([parent.to_owned(), child.to_owned()], Instant::now()));
        }
        true
    }

    /// The clock has jumped: what was known about frames that move is of before.
    pub(super) fn forget_moving(&self) {
        self.names().tree.remove_moving();
    }

    /// Notes that a transform of `child` is published here, with this time stamp, seconds: others that place it are rivals.
    pub fn note_published(&self, child: &str, stamp: f64) {
        let mut names = self.names();
        if !names.published.contains_key(child) {
            names.published.insert(child.to_owned(), VecDeque::new());
        }
        let Some(stamps) = names.published.get_mut(child) else { return };
        stamps.push_back(stamp);
        if stamps.len() > MOST_STAMPS {
            stamps.pop_front();
        }
    }

    /// Parent and child of a transform that is published here and by somebody else, too, if there is one.
    pub fn rival(&self) -> Option<[String; 2]> {
        self.names().rival.as_ref().filter(|(_, at)| at.elapsed() < RIVAL).map(|(link, _)| link.clone())
    }

    /// What scans wait for before they can be mapped, in words, if they do.
    pub fn waits_for(&self) -> Option<String> {
        self.log.waits_for()
    }

    /// What was done about transforms that have changed, since it was asked last.
    pub fn take_notes(&self) -> Vec<String> {
        self.log.take_notes()
    }

    /// Pose of a frame in another one: at a time in seconds, or as it was last. The frame of the clouds counts as known. `None` if nothing connects them.
    pub fn between(&self, a: &str, b: &str, time: Option<f64>) -> Option<Pose> {
        if a == b { Some(Pose::identity()) } else { self.names().tree.between(a, b, time) }
    }

    /// Names of all frames that are known, with that of the clouds and that of the poses.
    pub fn known(&self) -> Vec<String> {
        let names = self.names();
        let mut all: BTreeSet<String> = names.tree.frames().into_iter().map(str::to_owned).collect();
        all.extend(names.lidar.iter().chain(&names.poses).filter(|name| !name.is_empty()).cloned());
        all.into_iter().collect()
    }

    pub(super) fn set_clock(&self, time: f64) {
        self.names().clock = Some(time);
    }

    /// The time of the simulation, seconds; none without one.
    pub fn clock(&self) -> Option<f64> {
        self.names().clock
    }

    /// Pose of `frame` in the frame of the clouds, through fixed transforms.
    pub(super) fn beside_lidar(&self, frame: &str) -> Option<Pose> {
        let names = self.names();
        let lidar = names.lidar()?;
        if lidar == frame { Some(Pose::identity()) } else { names.tree.fixed(lidar, frame) }
    }

    /// The frame of the clouds, once one has come.
    pub fn lidar(&self) -> Option<String> {
        self.names().lidar().cloned()
    }

    /// The frame that the poses are in: that of the topic, else the root of the transform tree.
    pub fn odom(&self) -> Option<String> {
        let names = self.names();
        names.poses.clone().or_else(|| {
            let lidar = names.lidar()?;
            names.tree.moves(lidar).then(|| names.tree.ancestors(lidar).last().map(|root| (*root).to_owned()))?
        })
    }

    /// The frame of the robot, and its pose in the frame of the clouds: the end of the chain of fixed transforms from the lidar.
    pub fn base(&self) -> Option<(String, Pose)> {
        let names = self.names();
        let lidar = names.lidar()?;
        let fixed = names.tree.ancestors(lidar).into_iter().map_while(|frame| Some((frame.to_owned(), names.tree.fixed(lidar, frame)?)));
        fixed.last().or_else(|| Some((lidar.to_owned(), Pose::identity())))
    }

    /// The pose that the last scan came with; none where poses are estimated.
    pub fn reported(&self) -> Option<Reported> {
        let reported = self.log.reported()?;
        Some(Reported { node: reported.node, time: reported.time, t_odom_lidar: reported.t_odom_lidar })
    }

    /// Scans of which is kept how they could be read again.
    #[cfg(test)]
    pub(super) fn kept(&self) -> usize {
        self.log.kept()
    }

    /// Scans without a pose so far.
    pub fn without_pose(&self) -> usize {
        self.log.without_pose.load(std::sync::atomic::Ordering::Relaxed)
    }
}
