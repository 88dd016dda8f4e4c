//! Poses by time, as they come in, and trees of them.

use std::collections::{HashMap, VecDeque};
use voxelastic::Pose;

/// Poses this far apart in time are not one motion, seconds.
pub(crate) const LONGEST_GAP_S: f64 = 0.35;
/// Transforms are interpolated over longer gaps, as ROS does: a correction of the map may come once in seconds.
const LONGEST_TRANSFORM_GAP_S: f64 = 10.0;
/// A frame has at most this many ancestors; more is a loop.
const DEEPEST: usize = 64;

/// Poses in the order of their times.
#[derive(Clone, Debug, Default)]
pub(crate) struct Track {
    times: VecDeque<f64>,
    poses: VecDeque<Pose>,
}

impl Track {
    /// Adds a pose; one of a time that is there already takes its place.
    pub(crate) fn add(&mut self, time: f64, pose: Pose) {
        if !time.is_finite() {
            return;
        }
        let at = self.times.partition_point(|t| *t < time);
        if self.times.get(at) == Some(&time) {
            self.poses[at] = pose;
        } else {
            self.times.insert(at, time);
            self.poses.insert(at, pose);
        }
    }

    /// Time of the last pose.
    pub(crate) fn newest(&self) -> Option<f64> {
        self.times.back().copied()
    }

    /// Forgets what is older than `time`, but for the pose before it.
    pub(crate) fn forget_before(&mut self, time: f64) {
        let keep = self.times.partition_point(|t| *t < time).saturating_sub(1);
        self.times.drain(..keep);
        self.poses.drain(..keep);
    }

    /// The pose at a time: between two neighbours no more than `gap` seconds apart, else the nearest within `tolerance` seconds.
    pub(crate) fn at(&self, time: f64, gap: f64, tolerance: f64) -> Option<Pose> {
        let after = self.times.partition_point(|t| *t < time);
        if self.times.get(after) == Some(&time) {
            return Some(self.poses[after]);
        }
        let before = after.checked_sub(1);
        let after = Some(after).filter(|k| *k < self.times.len());
        if let (Some(a), Some(b)) = (before, after)
            && self.times[b] - self.times[a] <= gap
        {
            return between(&self.poses[a], &self.poses[b], (time - self.times[a]) / (self.times[b] - self.times[a]));
        }
        let off = |k: &usize| (self.times[*k] - time).abs();
        let nearest = before.into_iter().chain(after).min_by(|a, b| off(a).total_cmp(&off(b)))?;
        (off(&nearest) <= tolerance).then(|| self.poses[nearest])
    }
}

/// Interpolates; nothing if the rotations are opposite.
fn between(a: &Pose, b: &Pose, fraction: f64) -> Option<Pose> {
    let translation = a.translation.vector.lerp(&b.translation.vector, fraction);
    Some(Pose::from_parts(translation.into(), a.rotation.try_slerp(&b.rotation, fraction, 1e-9)?))
}

/// A frame's place in the tree.
#[derive(Clone, Debug)]
struct Link {
    parent: String,
    track: Track,
    is_fixed: bool,
}

/// The transform tree of `/tf` and `/tf_static`.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tree {
    links: HashMap<String, Link>,
}

impl Tree {
    /// Adds the pose of `child` in `parent`; `is_fixed` for ever.
    pub(crate) fn add(&mut self, parent: &str, child: &str, time: f64, pose: Pose, is_fixed: bool) {
        let link = self.links.entry(child.to_owned()).or_insert_with(|| Link { parent: parent.to_owned(), track: Track::default(), is_fixed });
        if link.parent != parent {
            *link = Link { parent: parent.to_owned(), track: Track::default(), is_fixed };
        }
        link.is_fixed |= is_fixed;
        link.track.add(if is_fixed { 0.0 } else { time }, pose);
    }

    /// The frame and its ancestors, up to the root.
    pub(crate) fn ancestors<'a>(&'a self, frame: &'a str) -> Vec<&'a str> {
        let mut chain = vec![frame];
        while let Some(link) = chain.last().and_then(|f| self.links.get(*f))
            && chain.len() < DEEPEST
        {
            chain.push(&link.parent);
        }
        chain
    }

    /// Whether any link between a frame and the root moves.
    pub(crate) fn moves(&self, frame: &str) -> bool {
        self.ancestors(frame).iter().any(|f| self.links.get(*f).is_some_and(|l| !l.is_fixed))
    }

    /// Pose of `frame` in the root of its tree.
    pub(crate) fn in_root(&self, frame: &str, time: f64, tolerance: f64) -> Option<Pose> {
        let mut t_root_frame = Pose::identity();
        let chain = self.ancestors(frame);
        for name in &chain[..chain.len() - 1] {
            let link = self.links.get(*name)?;
            let track = &link.track;
            let t_parent_child = if link.is_fixed { track.poses.back().copied()? } else { track.at(time, LONGEST_TRANSFORM_GAP_S, tolerance)? };
            t_root_frame = t_parent_child * t_root_frame;
        }
        Some(t_root_frame)
    }

    /// Time up to which the pose of `frame` is known; none if nothing moves it or a part has never been told.
    pub(crate) fn newest(&self, frame: &str) -> Option<f64> {
        let moving = self.ancestors(frame).into_iter().filter_map(|f| self.links.get(f)).filter(|l| !l.is_fixed);
        moving.filter_map(|l| l.track.newest()).min_by(f64::total_cmp)
    }

    /// Pose of frame `b` in frame `a` by fixed links alone.
    pub(crate) fn fixed(&self, a: &str, b: &str) -> Option<Pose> {
        let (up_a, up_b) = (self.ancestors(a), self.ancestors(b));
        let common = up_a.iter().find(|f| up_b.contains(f))?;
        let down = |chain: &[&str]| -> Option<Pose> {
            chain.iter().take_while(|f| *f != common).try_fold(Pose::identity(), |t_parent_frame, f| {
                let link = self.links.get(*f).filter(|l| l.is_fixed)?;
                Some(link.track.poses.back()? * t_parent_frame)
            })
        };
        Some(down(&up_a)?.inv_mul(&down(&up_b)?))
    }

    /// Forgets what is older than `time`.
    pub(crate) fn forget_before(&mut self, time: f64) {
        self.links.values_mut().filter(|l| !l.is_fixed).for_each(|l| l.track.forget_before(time));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn x(x: f64) -> Pose {
        Pose::translation(x, 0.0, 0.0)
    }

    #[test]
    fn poses_between_poses_in_whatever_order_they_come() {
        let mut track = Track::default();
        for t in [2.0, 1.0, 1.2, 1.1, 1.2] {
            track.add(t, x(t));
        }
        assert_eq!((track.times.len(), track.newest()), (4, Some(2.0)));
        let at = |t| track.at(t, LONGEST_GAP_S, 0.01).map(|p| p.translation.x);
        assert!((at(1.15).unwrap() - 1.15).abs() < 1e-12);
        assert_eq!((at(1.2), at(1.205), at(1.5), at(2.02)), (Some(1.2), Some(1.2), None, None));
        track.forget_before(1.15);
        assert_eq!(track.times.len(), 3);
    }

    #[test]
    fn a_tree_is_walked_up_and_down() {
        let mut tree = Tree::default();
        tree.add("map", "odom", 0.0, x(100.0), false);
        tree.add("map", "odom", 8.0, x(108.0), false);
        tree.add("odom", "base", 1.0, x(10.0), false);
        tree.add("odom", "base", 1.1, x(11.0), false);
        tree.add("base", "lidar", 0.0, x(1.0), true);
        tree.add("base", "imu", 0.0, x(0.5), true);
        assert_eq!(tree.ancestors("lidar"), ["lidar", "base", "odom", "map"]);
        assert!((tree.in_root("lidar", 1.05, 0.0).unwrap().translation.x - (101.05 + 10.5 + 1.0)).abs() < 1e-9);
        assert_eq!(tree.newest("lidar"), Some(1.1));
        assert!((tree.fixed("imu", "lidar").unwrap().translation.x - 0.5).abs() < 1e-12);
        assert!(tree.fixed("odom", "lidar").is_none() && tree.moves("lidar") && tree.in_root("lidar", 20.0, 0.0).is_none());
    }

    #[test]
    fn a_loop_in_the_tree_ends() {
        let mut tree = Tree::default();
        tree.add("a", "b", 0.0, x(1.0), true);
        tree.add("b", "a", 0.0, x(1.0), true);
        assert_eq!(tree.ancestors("a").len(), DEEPEST);
        let _ = (tree.in_root("a", 0.0, 0.0), tree.fixed("a", "zzz"));
    }
}
