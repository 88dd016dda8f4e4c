//! Choosing the topics of clouds and poses.

use super::messages::topic_role::TopicRole;
use super::packet_topics::PacketTopics;
use super::stream::is_static;
use super::summary::{CloudTopic, FurtherFrame, RecordingSummary};
use crate::motion::MAP_FRAMES;
use crate::playback::SensorMounts;
use crate::points::is_time;
use crate::stamped_cloud::Interval;
use crate::{Error, OpenOptions, Result};
use std::path::Path;
use voxelastic::Pose;

/// The chosen topics.
#[derive(Clone, Debug)]
pub(super) struct ChosenTopics {
    /// Those of the clouds, one for each sensor.
    pub(super) clouds: Vec<String>,
    /// Further sensors that publish to one of them: the topic, and the frame of their clouds.
    pub(super) frames: Vec<[String; 2]>,
    /// The topic of the poses; `None` if they come from a file.
    pub(super) poses: Option<(String, TopicRole)>,
    /// Frame of the first sensor's clouds.
    first_frame: String,
    /// The sensors of topics with packets.
    pub(super) packets: PacketTopics,
    /// How often clouds of each sensor come.
    pub(super) intervals: Vec<Interval>,
    pub(super) without_stamps: Vec<String>,
    /// What speaks for clouds of the first topic that are undistorted already, although their points have times.
    pub(super) undistorted_sign: Option<String>,
    /// What was decided about several sensors.
    pub(super) remark: Option<String>,
}

impl ChosenTopics {
    /// Where the sensors are on the vehicle.
    pub(super) fn mounts(&self, options: &OpenOptions) -> SensorMounts {
        let further = options.more_sensors.iter().map(|sensor| sensor.t_base_lidar);
        SensorMounts {
            given: std::iter::once(options.t_base_lidar).chain(further).collect(),
            first_frame: self.first_frame.clone(),
            ..SensorMounts::default()
        }
    }
}

/// Chooses the topics: those that are requested, else the only possible ones.
///
/// # Errors
/// [`Error::Ambiguous`] if there are several possibilities, [`Error::Dataset`] if there is none.
pub(super) fn choose(summary: &RecordingSummary, path: &Path, options: &OpenOptions) -> Result<ChosenTopics> {
    let mut clouds = Vec::new();
    let mut by_itself = false;
    match choose_clouds(summary, path, options.cloud_topic.as_deref()) {
        Ok(first) => clouds.push(first),
        Err(problem @ Error::Ambiguous { .. }) => {
            // A trajectory does not say which of the sensors its poses are of.
            clouds = options.poses.is_none().then(|| beside_each_other(summary)).flatten().ok_or(problem)?;
            by_itself = true;
        }
        Err(problem) => return Err(problem),
    }
    for sensor in &options.more_sensors {
        let further = choose_clouds(summary, path, Some(&sensor.topic))?;
        if clouds.contains(&further) {
            return Err(Error::dataset(path, format!("{further} is named twice"), "name each topic of clouds once"));
        }
        clouds.push(further);
    }
    let packets = PacketTopics::of(summary, path, &clouds, options)?;
    let poses = match options.poses {
        Some(_) => None,
        None => Some(choose_poses(summary, path, &clouds[0], options.pose_topic.as_deref())?),
    };
    if by_itself && poses.as_ref().is_some_and(|(_, role)| !matches!(role, TopicRole::Odometry | TopicRole::Transforms)) {
        // Neither does a message without a frame.
        choose_clouds(summary, path, None)?;
    }
    let frame = |topic: &String| summary.cloud_topics.get(topic).map(|g| g.frame.clone()).unwrap_or_default();
    let first_frame = frame(&clouds[0]);
    let by_transforms = matches!(poses, Some((_, TopicRole::Transforms)));
    for (k, topic) in clouds.iter().enumerate().skip(1) {
        let is_given = k.checked_sub(1).and_then(|k| options.more_sensors.get(k)).is_some_and(|sensor| sensor.t_base_lidar.is_some());
        if !is_given && !by_transforms && summary.tree.fixed(&first_frame, &frame(topic)).is_none() {
            let problem = format!("no fixed transform leads from {first_frame} ({}) to {} ({topic})", clouds[0], frame(topic));
            let remedy = "say where the sensors are: one --t-base-lidar for each --cloud-topic, in their order";
            return Err(Error::dataset(path, problem, remedy));
        }
    }
    let further = further_frames(summary, &clouds, &packets);
    if !by_transforms {
        further.iter().try_for_each(|frame| mounted_beside(summary, path, &first_frame, frame).map(drop))?;
    }
    let sensors = clouds.len() + further.len();
    let remark = (sensors > 1).then(|| {
        let choice = if by_itself { "; --cloud-topic chooses among them" } else { "" };
        let of_one: String = further.iter().map(|f| format!("; clouds of {} in {} are of a sensor of their own", f.topic, f.frame)).collect();
        format!("{sensors} sensors are mapped together, each with its own beams and its own pose on the vehicle{choice}{of_one}")
    });
    let intervals = summary.intervals(&clouds).into_iter().chain(further.iter().map(|frame| frame.interval.clone())).collect();
    let frames = further.into_iter().map(|frame| [frame.topic, frame.frame]).collect();
    let with_headers = clouds.iter().chain(poses.iter().filter(|(_, role)| *role != TopicRole::Path).map(|(name, _)| name));
    let without_stamps = summary.without_stamps(with_headers);
    let undistorted_sign = summary.undistorted_sign(&clouds[0]);
    Ok(ChosenTopics { intervals, without_stamps, undistorted_sign, clouds, frames, poses, first_frame, packets, remark })
}

/// The sensors that publish clouds to these topics beside the first of each.
pub(super) fn further_frames(summary: &RecordingSummary, clouds: &[String], packets: &PacketTopics) -> Vec<FurtherFrame> {
    let frames = summary.further_frames(clouds).into_iter();
    frames.filter(|further| !packets.sensors.contains_key(&further.topic)).collect()
}

/// Where such a sensor is in the frame of the first.
///
/// # Errors
/// [`Error::Dataset`] if no fixed transform says it.
pub(super) fn mounted_beside(summary: &RecordingSummary, path: &Path, first: &str, further: &FurtherFrame) -> Result<Pose> {
    summary.tree.fixed(first, &further.frame).ok_or_else(|| {
        let FurtherFrame { topic, frame, .. } = further;
        let problem = format!("clouds of {topic} are in several frames, and no fixed transform leads from {first} to {frame}");
        Error::dataset(path, problem, "record /tf_static, too, or have each sensor publish to a topic of its own, and say where they are: one --t-base-lidar for each --cloud-topic")
    })
}

/// The topics of several raw sensors that can be mapped together without a choice: clouds with times of their points, each in a frame of its own, with fixed
/// transforms between them. By name.
fn beside_each_other(summary: &RecordingSummary) -> Option<Vec<String>> {
    let mut found: Vec<(String, String)> = Vec::new();
    let mut names: Vec<String> = candidates(summary).into_iter().map(|(name, _)| name).collect();
    names.sort();
    for name in names {
        let CloudTopic { frame, fields, .. } = summary.cloud_topics.get(&name)?;
        if MAP_FRAMES.contains(&frame.as_str()) || !fields.iter().any(|f| is_time(f)) {
            continue;
        }
        let is_beside = found.first().is_none_or(|(_, first)| summary.tree.fixed(first, frame).is_some());
        // Two clouds in one frame are as a rule the same scans, processed differently.
        if frame.is_empty() || found.iter().any(|(_, other)| other == frame) || !is_beside {
            return None;
        }
        found.push((name, frame.clone()));
    }
    (found.len() > 1).then(|| found.into_iter().map(|(name, _)| name).collect())
}

/// The topics of scans: those with packets only where no other has clouds, which drivers make of them.
fn candidates(summary: &RecordingSummary) -> Vec<(String, TopicRole)> {
    let clouds = summary.of_role(|role| role.is_cloud() && role != TopicRole::Packets);
    if clouds.is_empty() { summary.of_role(TopicRole::is_cloud) } else { clouds }
}

/// Chooses the topic of the clouds: the requested one, else the only possible one.
///
/// # Errors
/// As [`choose`].
pub(super) fn choose_clouds(summary: &RecordingSummary, path: &Path, requested: Option<&str>) -> Result<String> {
    let all = if requested.is_some() { summary.of_role(TopicRole::is_cloud) } else { candidates(summary) };
    let names = || all.iter().map(|(name, _)| name.clone()).collect::<Vec<String>>();
    if let Some(requested) = requested {
        return find(&all, requested).map(|(name, _)| name).ok_or_else(|| unknown(path, requested, &names(), "--cloud-topic"));
    }
    if all.is_empty() {
        let remedy = "clouds are sensor_msgs/PointCloud2 or Livox CustomMsg, and in recordings packets of Velodyne, Hesai, RoboSense or Ouster; of others, have the driver make clouds and record those";
        return Err(Error::dataset(path, "no clouds in it", remedy));
    }
    let cloud_topic = |name: &str| summary.cloud_topics.get(name).cloned().unwrap_or_default();
    let in_map = |g: &CloudTopic| summary.registered_by(&g.frame).is_some() || MAP_FRAMES.contains(&g.frame.as_str());
    let raw: Vec<&String> = all.iter().map(|(name, _)| name).filter(|name| !in_map(&cloud_topic(name))).collect();
    let timed: Vec<&String> = raw.iter().copied().filter(|name| cloud_topic(name).fields.iter().any(|f| is_time(f))).collect();
    match (all.as_slice(), raw.as_slice(), timed.as_slice()) {
        ([(one, _)], ..) => Ok(one.clone()),
        (_, [one], _) | (_, _, [one]) => Ok((*one).clone()),
        _ => Err(Error::Ambiguous { path: path.into(), what: "topics of clouds", flag: "--cloud-topic", choices: names() }),
    }
}

/// Refuses clouds that were moved into the map by poses, where poses are to be estimated: in them the lidar stands still.
///
/// # Errors
/// [`Error::Dataset`] if the frame of the clouds is the one that poses of the recording are in.
pub(super) fn refuse_registered(summary: &RecordingSummary, path: &Path, clouds: &str) -> Result<()> {
    let Some((topic, by)) = summary.cloud_topics.get(clouds).and_then(|topic| Some((topic, summary.registered_by(&topic.frame)?))) else {
        return Ok(());
    };
    let problem = format!(
        "clouds of {clouds} are in {}, the frame that the poses of {by} are in: by these they were moved, and in them the lidar stands still",
        topic.frame
    );
    let remedy = format!("map them with those poses (--pose-topic {by}, without --slam), or choose the sensor's own clouds with --cloud-topic");
    Err(Error::dataset(path, problem, remedy))
}

/// The topics of further sensors whose poses are estimated, with the pose of each in the frame of the first: as the user says, else by fixed transforms.
///
/// # Errors
/// As [`choose`].
pub(super) fn choose_further_clouds(summary: &RecordingSummary, path: &Path, first: &str, options: &OpenOptions) -> Result<Vec<(String, Pose)>> {
    let frame = |topic: &str| summary.cloud_topics.get(topic).map(|g| g.frame.clone()).unwrap_or_default();
    let mut found: Vec<(String, Pose)> = Vec::new();
    for sensor in &options.more_sensors {
        let topic = choose_clouds(summary, path, Some(&sensor.topic))?;
        if topic == first || found.iter().any(|(other, _)| *other == topic) {
            return Err(Error::dataset(path, format!("{topic} is named twice"), "name each topic of clouds once"));
        }
        let given = options.t_base_lidar.zip(sensor.t_base_lidar).map(|(first, further)| first.inv_mul(&further));
        let t_first_sensor = given.or_else(|| summary.tree.fixed(&frame(first), &frame(&topic))).ok_or_else(|| {
            let problem = format!("no fixed transform leads from {} ({first}) to {} ({topic})", frame(first), frame(&topic));
            Error::dataset(path, problem, "say where the sensors are: one --t-base-lidar for each --cloud-topic, in their order")
        })?;
        found.push((topic, t_first_sensor));
    }
    Ok(found)
}

/// The topic of an inertial measurement unit, the pose of the unit in the frame of the clouds, and a remark.
#[derive(Clone, Debug, Default)]
pub(super) struct ChosenImu {
    /// `None` if there is none that can be used.
    pub(super) topic: Option<(String, Pose)>,
    /// What is used and why; empty if there is no unit.
    pub(super) remark: String,
}

/// Chooses the unit whose samples to use: the requested one, else the first whose place beside the lidar is known.
///
/// # Errors
/// [`Error::Dataset`] if the requested topic does not exist, or where its unit is is not known.
pub(super) fn choose_imu(summary: &RecordingSummary, packets: &PacketTopics, path: &Path, clouds: &str, options: &OpenOptions) -> Result<ChosenImu> {
    if let Some((name, pose)) = packets.imu(summary, clouds, options) {
        return Ok(ChosenImu { remark: format!("imu: {name}"), topic: Some((name, pose)) });
    }
    let mut all = summary.of_role(|role| role == TopicRole::Imu);
    all.sort_by(|a, b| a.0.cmp(&b.0));
    let names = || all.iter().map(|(name, _)| name.clone()).collect::<Vec<String>>();
    let frame = summary.cloud_topics.get(clouds).map(|g| g.frame.clone()).unwrap_or_default();
    let mounted = |name: &str| {
        let unit = summary.imu_frames.get(name)?;
        if *unit == frame { Some(Pose::identity()) } else { summary.tree.fixed(&frame, unit) }
    };
    let unknown_place = |name: &str| {
        let unit = summary.imu_frames.get(name).map_or("?", String::as_str);
        format!("no fixed transform says where {unit}, the frame of {name}, is in {frame}, the frame of the clouds")
    };
    if let Some(requested) = &options.imu_topic {
        let Some((name, _)) = find(&all, requested) else { return Err(unknown(path, requested, &names(), "--imu-topic")) };
        let pose = mounted(&name).ok_or_else(|| Error::dataset(path, unknown_place(&name), "record /tf_static, too, or do without --imu-topic"))?;
        return Ok(ChosenImu { remark: format!("imu: {name}"), topic: Some((name, pose)) });
    }
    let chosen = all.iter().find_map(|(name, _)| mounted(name).map(|pose| (name.clone(), pose))).filter(|_| options.use_imu);
    let remark = match (&chosen, all.first()) {
        (Some((name, _)), _) => format!("imu: {name}"),
        (None, Some((name, _))) if options.use_imu => format!("imu: not used: {}", unknown_place(name)),
        _ => String::new(),
    };
    Ok(ChosenImu { topic: chosen, remark })
}

/// The topic of poses of topics whose messages have not been seen: the requested one, else the only odometry, the only stamped pose, or `/tf`.
///
/// # Errors
/// As [`choose`].
pub(super) fn choose_live_poses(summary: &RecordingSummary, path: &Path, requested: Option<&str>) -> Result<(String, TopicRole)> {
    let all = summary.of_role(TopicRole::is_poses);
    let transforms = summary.of_role(|r| r == TopicRole::Transforms);
    let moving = || transforms.iter().filter(|(name, _)| !is_static(name));
    let names: Vec<String> = all.iter().chain(moving()).map(|(name, _)| name.clone()).collect();
    if let Some(requested) = requested {
        return find(&all, requested).or_else(|| find(&transforms, requested)).ok_or_else(|| unknown(path, requested, &names, "--pose-topic"));
    }
    // A path may be a plan.
    for role in [TopicRole::Odometry, TopicRole::PoseStamped] {
        let of_role: Vec<&(String, TopicRole)> = all.iter().filter(|(_, r)| *r == role).collect();
        match of_role.as_slice() {
            [] => {}
            [one] => return Ok((*one).clone()),
            _ => return Err(Error::Ambiguous { path: path.into(), what: "topics of poses", flag: "--pose-topic", choices: names }),
        }
    }
    let remedy = "poses are nav_msgs/Odometry, geometry_msgs/PoseStamped or /tf; without them --slam estimates the poses";
    moving().next().cloned().ok_or_else(|| Error::no_poses(path, "no topic of poses", remedy))
}

fn choose_poses(summary: &RecordingSummary, path: &Path, clouds: &str, requested: Option<&str>) -> Result<(String, TopicRole)> {
    let all = summary.of_role(TopicRole::is_poses);
    let transforms = summary.of_role(|r| r == TopicRole::Transforms);
    let frame = summary.cloud_topics.get(clouds).map(|g| g.frame.clone()).unwrap_or_default();
    let moving = transforms.iter().find(|(name, _)| !is_static(name)).filter(|_| summary.tree.moves(&frame));
    let mut names: Vec<String> = all.iter().map(|(name, _)| name.clone()).collect();
    names.extend(moving.map(|(name, _)| name.clone()));
    if let Some(requested) = requested {
        return find(&all, requested).or_else(|| find(&transforms, requested)).ok_or_else(|| unknown(path, requested, &names, "--pose-topic"));
    }
    // Odometry is the trajectory of the vehicle; single poses may be goals or fixes, paths may be plans.
    for role in [TopicRole::Odometry, TopicRole::PoseStamped, TopicRole::Path] {
        let of_role: Vec<&(String, TopicRole)> = all.iter().filter(|(_, r)| *r == role).collect();
        match of_role.as_slice() {
            [] => {}
            [one] => return Ok((*one).clone()),
            _ => return Err(Error::Ambiguous { path: path.into(), what: "topics of poses", flag: "--pose-topic", choices: names }),
        }
    }
    if moving.is_none() && summary.tree.is_apart(&frame) {
        let problem =
            format!("nothing in /tf leads from {frame}, the frame of {clouds}, to a frame that moves; the frames are: {}", summary.tree.drawing());
        let remedy = "name a topic of poses with --pose-topic and give the mounting with --t-base-lidar, name a trajectory with --poses, or let --slam estimate the poses";
        return Err(Error::dataset(path, problem, remedy));
    }
    moving.cloned().ok_or_else(|| {
        let remedy = "name a trajectory with times (TUM, Newer College) with --poses, such as the one that your SLAM system wrote or that `voxelastic odometry` makes";
        Error::no_poses(path, "no poses in it: no odometry, path, stamped poses or moving transforms", remedy)
    })
}

fn find(topics: &[(String, TopicRole)], requested: &str) -> Option<(String, TopicRole)> {
    let plain = |name: &str| name.trim_start_matches('/').to_owned();
    topics.iter().find(|(name, _)| plain(name) == plain(requested)).cloned()
}

fn unknown(path: &Path, requested: &str, names: &[String], flag: &str) -> Error {
    let there = if names.is_empty() { "none of that kind".into() } else { names.join(", ") };
    Error::dataset(path, format!("no such topic: {requested}; it has {there}"), format!("correct {flag}"))
}
