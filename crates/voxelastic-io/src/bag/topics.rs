//! Choosing the topics of clouds and poses.

use super::stream::is_static;
use super::summary::{CloudTopic, RecordingSummary};
use super::topic_role::TopicRole;
use crate::points::is_time;
use crate::{Error, OpenOptions, Result};
use std::path::Path;

/// Frames of clouds that have been transformed into the map frame.
const MAP_FRAMES: [&str; 5] = ["map", "odom", "world", "camera_init", "global"];

/// The chosen topics.
#[derive(Clone, Debug)]
pub(super) struct ChosenTopics {
    pub(super) clouds: String,
    /// The topic of the poses; `None` if they come from a file.
    pub(super) poses: Option<(String, TopicRole)>,
}

/// Chooses the topics: those that are requested, else the only possible ones.
///
/// # Errors
/// [`Error::Ambiguous`] if there are several possibilities, [`Error::Dataset`] if there is none.
pub(super) fn choose(summary: &RecordingSummary, path: &Path, options: &OpenOptions) -> Result<ChosenTopics> {
    let clouds = choose_clouds(summary, path, options.cloud_topic.as_deref())?;
    let poses = match options.poses {
        Some(_) => None,
        None => Some(choose_poses(summary, path, &clouds, options.pose_topic.as_deref())?),
    };
    Ok(ChosenTopics { clouds, poses })
}

/// Chooses the topic of the clouds: the requested one, else the only possible one.
///
/// # Errors
/// As [`choose`].
pub(super) fn choose_clouds(summary: &RecordingSummary, path: &Path, requested: Option<&str>) -> Result<String> {
    let all = summary.of_role(TopicRole::is_cloud);
    let names = || all.iter().map(|(name, _)| name.clone()).collect::<Vec<String>>();
    if let Some(requested) = requested {
        return find(&all, requested).map(|(name, _)| name).ok_or_else(|| unknown(path, requested, &names(), "--cloud-topic"));
    }
    if all.is_empty() {
        let remedy = "clouds are sensor_msgs/PointCloud2 or Livox CustomMsg; of raw packets (velodyne_msgs, ouster) convert to clouds first";
        return Err(Error::dataset(path, "no clouds in it", remedy));
    }
    let cloud_topic = |name: &str| summary.cloud_topics.get(name).cloned().unwrap_or_default();
    let in_map = |g: &CloudTopic| MAP_FRAMES.contains(&g.frame.as_str());
    let raw: Vec<&String> = all.iter().map(|(name, _)| name).filter(|name| !in_map(&cloud_topic(name))).collect();
    let timed: Vec<&String> = raw.iter().copied().filter(|name| cloud_topic(name).fields.iter().any(|f| is_time(f))).collect();
    match (all.as_slice(), raw.as_slice(), timed.as_slice()) {
        ([(one, _)], ..) => Ok(one.clone()),
        (_, [one], _) | (_, _, [one]) => Ok((*one).clone()),
        _ => Err(Error::Ambiguous { path: path.into(), what: "topics of clouds", flag: "--cloud-topic", choices: names() }),
    }
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
