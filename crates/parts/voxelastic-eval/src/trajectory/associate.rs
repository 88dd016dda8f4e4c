//! Association of the poses of two trajectories.

use hashbrown::HashMap;
use voxelastic::Pose;
use voxelastic::event::NodeId;

/// A pose with its time in seconds.
#[derive(Clone, Copy, Debug)]
pub struct StampedPose {
    /// Seconds.
    pub time: f64,
    /// The pose, in its trajectory's frame.
    pub pose: Pose,
}

/// A reference pose and its estimate.
#[derive(Clone, Copy, Debug)]
pub struct Pair {
    /// Time of the estimate in seconds, or its identifier when matched by identifier.
    pub time: f64,
    /// True pose, in the reference's frame.
    pub reference: Pose,
    /// Estimated pose, in the estimate's frame.
    pub estimate: Pose,
}

/// Matches each estimated pose to the reference pose nearest in time, if that is within `max_gap` seconds; each reference pose is matched
/// at most once, to its nearest estimate. Sorted by time. Poses that are not finite are left out.
pub fn by_time(reference: &[StampedPose], estimate: &[StampedPose], max_gap: f64) -> Vec<Pair> {
    let sorted = |list: &[StampedPose]| {
        let mut out: Vec<StampedPose> = list.iter().filter(|p| p.time.is_finite() && is_finite(&p.pose)).copied().collect();
        out.sort_by(|a, b| a.time.total_cmp(&b.time));
        out
    };
    let (reference, estimate) = (sorted(reference), sorted(estimate));
    // Per reference pose, the gap to the nearest estimate and its index.
    let mut matches: Vec<Option<(f64, usize)>> = vec![None; reference.len()];
    for (e, pose) in estimate.iter().enumerate() {
        let after = reference.partition_point(|r| r.time < pose.time);
        let nearest = [after.checked_sub(1), Some(after)].into_iter().flatten().filter(|&r| r < reference.len());
        let nearest = nearest.map(|r| ((reference[r].time - pose.time).abs(), r)).min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((gap, r)) = nearest.filter(|n| n.0 <= max_gap)
            && matches[r].is_none_or(|(other, _)| gap < other)
        {
            matches[r] = Some((gap, e));
        }
    }
    let pair = |(r, found): (usize, &Option<(f64, usize)>)| {
        found.map(|(_, e)| Pair { time: estimate[e].time, reference: reference[r].pose, estimate: estimate[e].pose })
    };
    matches.iter().enumerate().filter_map(pair).collect()
}

/// Matches poses by identifier, in the order of the estimate. For a repeated identifier the last reference pose is used.
pub fn by_id(reference: &[(NodeId, Pose)], estimate: &[(NodeId, Pose)]) -> Vec<Pair> {
    let reference: HashMap<NodeId, Pose> = reference.iter().filter(|p| is_finite(&p.1)).copied().collect();
    let pair = |(id, pose): &(NodeId, Pose)| reference.get(id).map(|r| Pair { time: *id as f64, reference: *r, estimate: *pose });
    estimate.iter().filter(|p| is_finite(&p.1)).filter_map(pair).collect()
}

fn is_finite(t: &Pose) -> bool {
    t.translation.vector.iter().chain(t.rotation.coords.iter()).all(|v| v.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion};

    fn at(time: f64) -> StampedPose {
        StampedPose { time, pose: Pose::from_parts(Translation3::new(time, 0.0, 0.0), UnitQuaternion::identity()) }
    }

    #[test]
    fn poses_are_matched_once_to_the_nearest_in_time() {
        let reference = [at(0.0), at(1.0), at(2.0), at(10.0)];
        let estimate = [at(2.04), at(0.02), at(1.4), at(1.03), at(f64::NAN), at(5.0)];
        let pairs = by_time(&reference, &estimate, 0.5);
        let times: Vec<(f64, f64)> = pairs.iter().map(|p| (p.reference.translation.x, p.time)).collect();
        assert_eq!(times, [(0.0, 0.02), (1.0, 1.03), (2.0, 2.04)]);
    }

    #[test]
    fn identifiers_match_whatever_the_order() {
        let pose = |x: f64| at(x).pose;
        let pairs = by_id(&[(7, pose(7.0)), (3, pose(3.0))], &[(3, pose(3.5)), (9, pose(9.5)), (7, pose(7.5))]);
        assert_eq!(pairs.iter().map(|p| p.reference.translation.x).collect::<Vec<_>>(), [3.0, 7.0]);
    }
}
