//! Which topics are subscribed to.

use super::super::containers::container::{Encoding, Topic};
use super::super::messages::topic_role::TopicRole;
use super::super::stream::StreamTopics;
use super::super::summary::RecordingSummary;
use super::super::topics::{choose_clouds, choose_live_poses};
use crate::{Error, OpenOptions, PointTimes, Result};
use std::path::{Path, PathBuf};

/// The topics of transforms, which are always subscribed to: they say where the lidar is on the robot.
const TRANSFORMS: [&str; 2] = ["/tf", "/tf_static"];
/// Their type.
const TRANSFORM_KIND: &str = "tf2_msgs/msg/TFMessage";
/// The time of a simulation, and its type.
const CLOCK: [&str; 2] = ["/clock", "rosgraph_msgs/msg/Clock"];

/// A topic to subscribe to.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct LiveTopic {
    /// Such as `/points`.
    pub name: String,
    /// Such as `sensor_msgs/msg/PointCloud2`.
    pub kind: String,
    /// Whether the last message that was published before the subscription is needed (transient-local, reliable).
    pub is_latched: bool,
    /// Whether messages may be lost rather than be late (sensor data).
    pub is_sensor_data: bool,
    /// Whether messages should come all the time: if none do, something is wrong.
    pub is_steady: bool,
}

/// The topics that are used, and for what.
#[derive(Clone, Debug)]
pub struct LiveTopics {
    pub(super) origin: PathBuf,
    pub(super) stream: StreamTopics,
    /// Whether the poses are those of the transform tree.
    pub(super) by_transforms: bool,
    subscriptions: Vec<LiveTopic>,
}

impl LiveTopics {
    /// Chooses among the topics that are there, each with its type: those that are requested, else the only ones that are possible. `origin` is where they
    /// are, for messages. If poses are estimated, none are subscribed to, but the inertial measurement unit is.
    ///
    /// # Errors
    /// [`Error::Ambiguous`] if several topics could be meant; [`Error::Dataset`] if there are no clouds or a requested topic does not exist;
    /// [`Error::NoPoses`].
    pub fn choose(origin: &str, there: &[(String, String)], estimates_poses: bool, options: &OpenOptions) -> Result<Self> {
        let path = Path::new(origin);
        let topics = there.iter().map(|(name, kind)| Topic::new(name.clone(), kind, Encoding::Cdr));
        // A live sensor's packets are read from the network.
        let topics = topics.filter(|topic| TopicRole::of(topic) != Some(TopicRole::Packets)).collect();
        let summary = RecordingSummary::of_topics(topics);
        let mut clouds = vec![choose_clouds(&summary, path, options.cloud_topic.as_deref())?];
        for sensor in &options.more_sensors {
            let further = choose_clouds(&summary, path, Some(&sensor.topic))?;
            if clouds.contains(&further) {
                return Err(Error::dataset(path, format!("{further} is named twice"), "name each topic of clouds once"));
            }
            clouds.push(further);
        }
        let stretches_times = options.point_times == PointTimes::OverInterval;
        let mut stream =
            StreamTopics { clouds, stretches_times, are_unexamined: options.point_times == PointTimes::Undecided, ..StreamTopics::default() };
        let mut by_transforms = false;
        if estimates_poses {
            stream.imu = choose_imu(&summary, path, options)?;
        } else {
            let (name, role) = choose_live_poses(&summary, path, options.pose_topic.as_deref())?;
            by_transforms = role == TopicRole::Transforms;
            stream.poses = (!by_transforms).then_some(name);
            // It need not be there yet: a SLAM system may publish it with its first loop.
            stream.corrections = options.correction_topic.as_deref().map(absolute);
        }
        let kind = |name: &str| there.iter().find(|(n, _)| n == name).map_or("nav_msgs/msg/Path", |(_, kind)| kind);
        let topic = |name: &String, is_sensor_data, is_steady| LiveTopic {
            name: name.clone(),
            kind: kind(name).to_owned(),
            is_latched: false,
            is_sensor_data,
            is_steady,
        };
        let mut subscriptions: Vec<LiveTopic> = stream.clouds.iter().map(|name| topic(name, true, true)).collect();
        subscriptions.extend(stream.imu.iter().map(|name| topic(name, true, true)));
        subscriptions.extend(stream.poses.iter().map(|name| topic(name, false, true)));
        subscriptions.extend(stream.corrections.iter().map(|name| topic(name, false, false)));
        subscriptions.extend(TRANSFORMS.map(|name| LiveTopic {
            name: name.to_owned(),
            kind: TRANSFORM_KIND.to_owned(),
            is_latched: name == TRANSFORMS[1],
            is_sensor_data: false,
            is_steady: by_transforms && name == TRANSFORMS[0],
        }));
        Ok(Self { origin: path.into(), stream, by_transforms, subscriptions })
    }

    /// With transforms from other topics than `/tf` and `/tf_static`, as those of a robot whose names have a namespace.
    #[must_use]
    pub fn with_transforms(mut self, [moving, fixed]: [&str; 2]) -> Self {
        for topic in self.subscriptions.iter_mut().filter(|topic| topic.kind == TRANSFORM_KIND) {
            topic.name = if topic.is_latched { fixed } else { moving }.to_owned();
        }
        self
    }

    /// The topics of transforms: those that move, and fixed ones.
    pub fn transforms(&self) -> [&str; 2] {
        let name = |is_latched| self.subscriptions.iter().find(|topic| topic.kind == TRANSFORM_KIND && topic.is_latched == is_latched);
        [false, true].map(|is_latched| name(is_latched).map_or("", |topic| topic.name.as_str()))
    }

    /// Topics of clouds, one for each sensor.
    pub fn clouds(&self) -> &[String] {
        &self.stream.clouds
    }

    /// With the clock of a simulation, which tells the time instead of this machine's.
    #[must_use]
    pub fn with_clock(mut self) -> Self {
        let [name, kind] = CLOCK.map(str::to_owned);
        self.subscriptions.push(LiveTopic { name, kind, is_latched: false, is_sensor_data: true, is_steady: true });
        self
    }

    /// The position of the clock in the subscriptions, if it is among them.
    pub(super) fn clock(&self) -> Option<usize> {
        self.subscriptions.iter().position(|topic| topic.kind == CLOCK[1])
    }

    /// The topics to subscribe to.
    pub fn subscriptions(&self) -> &[LiveTopic] {
        &self.subscriptions
    }

    /// What is used for what, in a few lines.
    pub fn description(&self) -> String {
        let StreamTopics { clouds, poses, corrections, imu, .. } = &self.stream;
        let mut lines = vec![format!("clouds: {}", clouds.join(", "))];
        lines.push(match poses {
            Some(topic) => format!("poses: {topic}"),
            None if self.by_transforms => format!("poses: {}", self.transforms()[0]),
            None => "poses: by odometry".to_owned(),
        });
        lines.extend(corrections.iter().map(|topic| format!("corrections: {topic}")));
        lines.extend(imu.iter().map(|topic| format!("imu: {topic}")));
        if self.transforms() != TRANSFORMS {
            lines.push(format!("transforms: {}", self.transforms().join(", ")));
        }
        lines.join("\n")
    }
}

/// The topic of the inertial measurement unit: the requested one, else the first by name, if one is to be used.
fn choose_imu(summary: &RecordingSummary, path: &Path, options: &OpenOptions) -> Result<Option<String>> {
    let mut names: Vec<String> = summary.of_role(|role| role == TopicRole::Imu).into_iter().map(|(name, _)| name).collect();
    names.sort();
    match &options.imu_topic {
        Some(requested) => match names.into_iter().find(|name| *name == absolute(requested)) {
            Some(name) => Ok(Some(name)),
            None => Err(Error::dataset(path, format!("no such topic of an inertial measurement unit: {requested}"), "correct --imu-topic")),
        },
        None => Ok(names.into_iter().next().filter(|_| options.use_imu)),
    }
}

fn absolute(name: &str) -> String {
    format!("/{}", name.trim_start_matches('/'))
}
