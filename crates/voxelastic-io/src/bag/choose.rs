//! Which topics are meant.

use super::messages::Role;
use super::survey::{Glimpse, Survey};
use crate::channels::is_time;
use crate::{Error, OpenOptions, Result};
use std::path::Path;

/// Frames that clouds are in when they have been moved into the map.
const MAP_FRAMES: [&str; 5] = ["map", "odom", "world", "camera_init", "global"];

/// The topics that are used.
#[derive(Clone, Debug)]
pub(super) struct Choice {
    pub(super) clouds: String,
    /// Where poses are from; none if they are given in a file.
    pub(super) poses: Option<(String, Role)>,
}

/// Chooses the topics: those that are asked for, else those that alone can be meant.
///
/// # Errors
/// [`Error::Ambiguous`] if several could be meant, [`Error::Dataset`] if there are none.
pub(super) fn choose(survey: &Survey, path: &Path, options: &OpenOptions) -> Result<Choice> {
    let clouds = clouds(survey, path, options.cloud_topic.as_deref())?;
    let poses = match options.poses {
        Some(_) => None,
        None => Some(poses(survey, path, &clouds, options.pose_topic.as_deref())?),
    };
    Ok(Choice { clouds, poses })
}

fn clouds(survey: &Survey, path: &Path, asked: Option<&str>) -> Result<String> {
    let all = survey.of_role(Role::is_cloud);
    let names = || all.iter().map(|(name, _)| name.clone()).collect::<Vec<String>>();
    if let Some(asked) = asked {
        return find(&all, asked).map(|(name, _)| name).ok_or_else(|| unknown(path, asked, &names(), "--cloud-topic"));
    }
    if all.is_empty() {
        let remedy = "clouds are sensor_msgs/PointCloud2 or Livox CustomMsg; of raw packets (velodyne_msgs, ouster) convert to clouds first";
        return Err(Error::dataset(path, "no clouds in it", remedy));
    }
    let glimpse = |name: &str| survey.glimpses.get(name).cloned().unwrap_or_default();
    let in_map = |g: &Glimpse| MAP_FRAMES.contains(&g.frame.as_str());
    let raw: Vec<&String> = all.iter().map(|(name, _)| name).filter(|name| !in_map(&glimpse(name))).collect();
    let timed: Vec<&String> = raw.iter().copied().filter(|name| glimpse(name).fields.iter().any(|f| is_time(f))).collect();
    match (all.as_slice(), raw.as_slice(), timed.as_slice()) {
        ([(one, _)], ..) => Ok(one.clone()),
        (_, [one], _) | (_, _, [one]) => Ok((*one).clone()),
        _ => Err(Error::Ambiguous { path: path.into(), what: "topics of clouds", flag: "--cloud-topic", choices: names() }),
    }
}

fn poses(survey: &Survey, path: &Path, clouds: &str, asked: Option<&str>) -> Result<(String, Role)> {
    let all = survey.of_role(Role::is_poses);
    let transforms = survey.of_role(|r| r == Role::Transforms);
    let frame = survey.glimpses.get(clouds).map(|g| g.frame.clone()).unwrap_or_default();
    let moving = transforms.iter().find(|(name, _)| !super::tape::is_static(name)).filter(|_| survey.tree.moves(&frame));
    let mut names: Vec<String> = all.iter().map(|(name, _)| name.clone()).collect();
    names.extend(moving.map(|(name, _)| name.clone()));
    if let Some(asked) = asked {
        return find(&all, asked).or_else(|| find(&transforms, asked)).ok_or_else(|| unknown(path, asked, &names, "--pose-topic"));
    }
    // Odometry is the trajectory of the vehicle; single poses may be goals or fixes, paths may be plans.
    for role in [Role::Odometry, Role::PoseStamped, Role::Path] {
        let of_role: Vec<&(String, Role)> = all.iter().filter(|(_, r)| *r == role).collect();
        match of_role.as_slice() {
            [] => {}
            [one] => return Ok((*one).clone()),
            _ => return Err(Error::Ambiguous { path: path.into(), what: "topics of poses", flag: "--pose-topic", choices: names }),
        }
    }
    moving.cloned().ok_or_else(|| {
        let remedy = "name a trajectory with times (TUM, Newer College) with --poses, such as the one that your SLAM system wrote";
        Error::dataset(path, "no poses in it: no odometry, path, stamped poses or moving transforms", remedy)
    })
}

fn find(topics: &[(String, Role)], asked: &str) -> Option<(String, Role)> {
    let plain = |name: &str| name.trim_start_matches('/').to_owned();
    topics.iter().find(|(name, _)| plain(name) == plain(asked)).cloned()
}

fn unknown(path: &Path, asked: &str, names: &[String], flag: &str) -> Error {
    let there = if names.is_empty() { "none of that kind".into() } else { names.join(", ") };
    Error::dataset(path, format!("no such topic: {asked}; it has {there}"), format!("correct {flag}"))
}
