//! Matching poses to clouds.

use crate::folders::{CloudFile, scan_numbers};
use crate::{Error, Result, Trajectory};
use std::path::Path;
use voxelastic::Pose;

/// Times that differ by no more than this are equal up to their precision in the file, seconds.
const SAME_TIME_S: f64 = 1e-4;
/// Poses are not interpolated over longer gaps, seconds: a trajectory needs at least 10 Hz.
const LONGEST_GAP_S: f64 = 0.11;

/// How poses were matched to clouds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum MatchedBy {
    /// As many poses as clouds: the k-th pose belongs to the k-th cloud.
    Order,
    /// Cloud names end with the number of their pose (counted from 0) or of their node.
    Number,
    /// By time.
    Time,
}

impl std::fmt::Display for MatchedBy {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Order => "by order",
            Self::Number => "by the number in the cloud's name",
            Self::Time => "by time",
        })
    }
}

/// A pose for each cloud that has one.
pub(super) struct Matched {
    pub(super) poses: Vec<Option<Pose>>,
    /// The time of each pose, if the trajectory has times but was not matched by them.
    pub(super) times: Vec<Option<f64>>,
    pub(super) by: MatchedBy,
    /// Poses that belong to no cloud.
    pub(super) unused: usize,
}

/// The clouds, as far as poses are matched to them.
#[derive(Clone, Copy)]
pub(super) struct Clouds<'a> {
    pub(super) files: &'a [CloudFile],
    /// Times of the clouds in seconds, if known.
    pub(super) times: Option<&'a [f64]>,
    /// How far the nearest pose may be in time, seconds.
    pub(super) tolerance_s: f64,
}

impl Clouds<'_> {
    /// The numbers that all names end with, if they are scan numbers.
    pub(super) fn numbers(&self) -> Option<Vec<u64>> {
        scan_numbers(self.files)
    }
}

/// Matches a trajectory to the clouds: by time, by order, or by the numbers in the names.
///
/// # Errors
/// [`Error::Dataset`] if none of these applies.
pub(super) fn match_poses(clouds: Clouds<'_>, trajectory: &Trajectory, path: &Path) -> Result<Matched> {
    let count = clouds.files.len();
    if let (Some(cloud_times), Some(pose_times)) = (clouds.times, &trajectory.times) {
        return by_time(clouds, cloud_times, pose_times, &trajectory.poses, path);
    }
    if trajectory.len() == count {
        return Ok(by_index(trajectory, 0..count, MatchedBy::Order));
    }
    let Some(numbers) = clouds.numbers() else { return Err(mismatch(count, trajectory, path)) };
    let position = |number: u64| match &trajectory.nodes {
        Some(ids) => ids.binary_search(&number).ok(),
        None => usize::try_from(number).ok().filter(|n| *n < trajectory.len()),
    };
    // With more clouds than poses the names must count from 0, or the k-th pose could be meant for the k-th cloud.
    let counts_from_zero = trajectory.nodes.is_some() || trajectory.len() > count || numbers.first() == Some(&0);
    let indices: Vec<usize> = numbers.iter().map(|n| position(*n).unwrap_or(usize::MAX)).collect();
    if !counts_from_zero || indices.iter().all(|i| *i == usize::MAX) {
        return Err(mismatch(count, trajectory, path));
    }
    Ok(by_index(trajectory, indices.into_iter(), MatchedBy::Number))
}

fn by_index(trajectory: &Trajectory, indices: impl Iterator<Item = usize>, by: MatchedBy) -> Matched {
    let (mut poses, mut times) = (Vec::new(), Vec::new());
    for index in indices {
        poses.push(trajectory.poses.get(index).copied());
        times.push(trajectory.times.as_ref().and_then(|t| t.get(index)).copied());
    }
    let unused = trajectory.len() - poses.iter().flatten().count();
    Matched { poses, times, by, unused }
}

fn by_time(clouds: Clouds<'_>, cloud_times: &[f64], pose_times: &[f64], poses: &[Pose], path: &Path) -> Result<Matched> {
    let mut used = vec![false; poses.len()];
    let matched: Vec<Option<Pose>> = cloud_times.iter().map(|t| pose_at(*t, pose_times, poses, clouds.tolerance_s, &mut used)).collect();
    if matched.iter().all(Option::is_none) {
        let span = |times: &[f64]| match times {
            [first, .., last] => format!("{first} to {last}"),
            [only] => only.to_string(),
            [] => "nothing".into(),
        };
        let problem = format!("no pose has the time of a cloud: clouds are from {} s, poses from {} s", span(cloud_times), span(pose_times));
        return Err(Error::dataset(path, problem, "use poses of the same clock, in seconds"));
    }
    let unused = used.iter().filter(|u| !**u).count();
    Ok(Matched { times: vec![None; matched.len()], poses: matched, by: MatchedBy::Time, unused })
}

/// The pose at a time: the one of that time, else interpolated between two close neighbours, else the nearest within tolerance.
fn pose_at(time: f64, times: &[f64], poses: &[Pose], tolerance_s: f64, used: &mut [bool]) -> Option<Pose> {
    let after = times.partition_point(|t| *t < time);
    let before = after.checked_sub(1);
    let after = Some(after).filter(|k| *k < times.len());
    let nearest = match (before, after) {
        (Some(a), Some(b)) => Some(if time - times[a] < times[b] - time { a } else { b }),
        (a, b) => a.or(b),
    }?;
    let off = (times[nearest] - time).abs();
    if off > SAME_TIME_S
        && let (Some(a), Some(b)) = (before, after)
        && times[b] - times[a] <= LONGEST_GAP_S
        && let Some(pose) = between(&poses[a], &poses[b], (time - times[a]) / (times[b] - times[a]))
    {
        (used[a], used[b]) = (true, true);
        return Some(pose);
    }
    if off > tolerance_s.max(SAME_TIME_S) {
        return None;
    }
    used[nearest] = true;
    Some(poses[nearest])
}

/// Interpolates; `None` if the rotations are opposite, which is implausible within a tenth of a second.
fn between(a: &Pose, b: &Pose, fraction: f64) -> Option<Pose> {
    let translation = a.translation.vector.lerp(&b.translation.vector, fraction);
    let rotation = a.rotation.try_slerp(&b.rotation, fraction, 1e-9)?;
    Some(Pose::from_parts(translation.into(), rotation))
}

fn mismatch(clouds: usize, trajectory: &Trajectory, path: &Path) -> Error {
    let problem = format!("{} poses for {clouds} clouds, and neither times nor the clouds' names say which belong together", trajectory.len());
    Error::dataset(path, problem, "give one pose per cloud, a times.txt with the time of each cloud, or another file with --poses")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files(names: &[&str]) -> Vec<CloudFile> {
        let file = |stem: &&str| CloudFile { path: format!("{stem}.pcd").into(), number: crate::file_names::number(stem), stamp: None };
        names.iter().map(file).collect()
    }

    fn trajectory(count: usize, times: Option<Vec<f64>>) -> Trajectory {
        Trajectory { poses: (0..count).map(|k| Pose::translation(k as f64, 0.0, 0.0)).collect(), times, nodes: None }
    }

    fn xs(clouds: &[CloudFile], times: Option<&[f64]>, trajectory: &Trajectory) -> Result<Vec<Option<f64>>> {
        let matched = match_poses(Clouds { files: clouds, times, tolerance_s: 0.01 }, trajectory, Path::new("p"))?;
        Ok(matched.poses.iter().map(|p| p.map(|p| p.translation.x)).collect())
    }

    #[test]
    fn equal_counts_match_by_order() {
        assert_eq!(xs(&files(&["7", "9"]), None, &trajectory(2, None)).unwrap(), [Some(0.0), Some(1.0)]);
    }

    #[test]
    fn unequal_counts_match_by_number_or_not_at_all() {
        assert_eq!(xs(&files(&["1", "3"]), None, &trajectory(5, None)).unwrap(), [Some(1.0), Some(3.0)]);
        assert_eq!(xs(&files(&["0", "1", "2"]), None, &trajectory(2, None)).unwrap(), [Some(0.0), Some(1.0), None]);
        assert!(xs(&files(&["1", "2", "3"]), None, &trajectory(2, None)).is_err());
        assert!(xs(&files(&["a", "b", "c"]), None, &trajectory(2, None)).unwrap_err().to_string().contains("2 poses for 3 clouds"));
        assert!(xs(&files(&["90", "91"]), None, &trajectory(5, None)).is_err());
    }

    #[test]
    fn times_match_exactly_between_or_within_tolerance() {
        let poses = trajectory(4, Some(vec![1.0, 1.1, 5.0, 6.0]));
        let clouds = files(&["0", "1", "2", "3", "4"]);
        let matched = xs(&clouds, Some(&[1.0, 1.025, 5.009, 5.5, 6.02]), &poses).unwrap();
        assert_eq!(matched[0], Some(0.0));
        assert!((matched[1].unwrap() - 0.25).abs() < 1e-9);
        assert_eq!(matched[2..], [Some(2.0), None, None]);
        let error = xs(&clouds, Some(&[1e9, 2e9, 3e9, 4e9, 5e9]), &poses).unwrap_err().to_string();
        assert!(error.contains("same clock"), "{error}");
    }
}
