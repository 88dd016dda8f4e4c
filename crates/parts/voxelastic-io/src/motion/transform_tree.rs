//! The transform tree of `/tf` and `/tf_static`.

use super::pose_track::{LONGEST_GAP_S, PoseTrack};
use std::collections::{BTreeSet, HashMap};
use voxelastic::Pose;

/// Transforms are interpolated over longer gaps than poses, as ROS does: corrections of the map may be seconds apart.
const LONGEST_TRANSFORM_GAP_S: f64 = 10.0;
/// A frame has at most this many ancestors; more means a cycle.
const DEEPEST: usize = 64;

/// The link from a frame to its parent.
#[derive(Clone, Debug)]
struct Link {
    parent: String,
    track: PoseTrack,
    is_fixed: bool,
}

/// Frames and their poses in their parents.
#[derive(Clone, Debug, Default)]
pub(crate) struct TransformTree {
    links: HashMap<String, Link>,
}

impl TransformTree {
    /// Adds the pose of `child` in `parent`; a fixed one holds at all times.
    pub(crate) fn add(&mut self, parent: &str, child: &str, time: f64, pose: Pose, is_fixed: bool) {
        let link = self.links.entry(child.to_owned()).or_insert_with(|| Link { parent: parent.to_owned(), track: PoseTrack::default(), is_fixed });
        if link.parent != parent {
            *link = Link { parent: parent.to_owned(), track: PoseTrack::default(), is_fixed };
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

    /// Whether frames move, but none in the tree of this one.
    pub(crate) fn is_apart(&self, frame: &str) -> bool {
        let root = |frame: &str| self.ancestors(frame).last().map(|root| (*root).to_owned());
        let mut moving = self.links.iter().filter(|(_, link)| !link.is_fixed).map(|(child, _)| root(child)).peekable();
        moving.peek().is_some() && moving.all(|of_moving| of_moving != root(frame))
    }

    /// Pose of `frame` in the root of its tree.
    pub(crate) fn in_root(&self, frame: &str, time: f64, tolerance: f64) -> Option<Pose> {
        let mut t_root_frame = Pose::identity();
        let chain = self.ancestors(frame);
        for name in &chain[..chain.len() - 1] {
            let link = self.links.get(*name)?;
            let track = &link.track;
            let t_parent_child = if link.is_fixed { track.last().copied()? } else { track.at(time, LONGEST_TRANSFORM_GAP_S, tolerance)? };
            t_root_frame = t_parent_child * t_root_frame;
        }
        Some(t_root_frame)
    }

    /// Time up to which the pose of `frame` is known; `None` if no link of its chain moves.
    pub(crate) fn newest(&self, frame: &str) -> Option<f64> {
        let moving = self.ancestors(frame).into_iter().filter_map(|f| self.links.get(f)).filter(|l| !l.is_fixed);
        moving.filter_map(|l| l.track.newest()).min_by(f64::total_cmp)
    }

    /// Pose of frame `b` in frame `a` through fixed links only.
    pub(crate) fn fixed(&self, a: &str, b: &str) -> Option<Pose> {
        let (up_a, up_b) = (self.ancestors(a), self.ancestors(b));
        let common = up_a.iter().find(|f| up_b.contains(f))?;
        let down = |chain: &[&str]| -> Option<Pose> {
            chain.iter().take_while(|f| *f != common).try_fold(Pose::identity(), |t_parent_frame, f| {
                let link = self.links.get(*f).filter(|l| l.is_fixed)?;
                Some(link.track.last()? * t_parent_frame)
            })
        };
        Some(down(&up_a)?.inv_mul(&down(&up_b)?))
    }

    /// Pose of frame `b` in frame `a`, through links that move, too: at a time, or as each link was last. `None` if nothing connects them, or a link is not known at that time.
    pub(crate) fn between(&self, a: &str, b: &str, time: Option<f64>) -> Option<Pose> {
        let (up_a, up_b) = (self.ancestors(a), self.ancestors(b));
        let common = up_a.iter().find(|f| up_b.contains(f))?;
        let down = |chain: &[&str]| -> Option<Pose> {
            chain.iter().take_while(|f| *f != common).try_fold(Pose::identity(), |t_parent_frame, f| {
                let link = self.links.get(*f)?;
                let pose = match time.filter(|_| !link.is_fixed) {
                    Some(time) => link.track.at(time, LONGEST_TRANSFORM_GAP_S, LONGEST_GAP_S),
                    None => link.track.last().copied(),
                };
                Some(pose? * t_parent_frame)
            })
        };
        Some(down(&up_a)?.inv_mul(&down(&up_b)?))
    }

    /// Whether a transform of `child` is known that is more than `seconds` later than `time`: its clock has gone back.
    pub(crate) fn is_later(&self, child: &str, time: f64, seconds: f64) -> bool {
        self.links.get(child).is_some_and(|link| !link.is_fixed && link.track.newest().is_some_and(|newest| newest > time + seconds))
    }

    /// All frames, by name.
    pub(crate) fn frames(&self) -> BTreeSet<&str> {
        self.links.iter().flat_map(|(child, link)| [child.as_str(), link.parent.as_str()]).collect()
    }

    /// The frames as trees, one on each line: `odom > base_link > (imu, laser)`. A `~` stands before frames that move in their parent.
    pub(crate) fn drawing(&self) -> String {
        let is_child = |frame: &str| self.links.contains_key(frame);
        let roots: BTreeSet<&str> = self.links.values().map(|link| link.parent.as_str()).filter(|parent| !is_child(parent)).collect();
        roots.into_iter().map(|root| self.branch(root, 0)).collect::<Vec<_>>().join("; ")
    }

    fn branch(&self, frame: &str, depth: usize) -> String {
        let mut children: Vec<(&str, &Link)> =
            self.links.iter().filter(|(_, link)| link.parent == frame).map(|(child, link)| (child.as_str(), link)).collect();
        if depth >= DEEPEST || children.is_empty() {
            return frame.to_owned();
        }
        children.sort_by_key(|(child, _)| *child);
        let below = children.iter().map(|(child, link)| format!("{}{}", if link.is_fixed { "" } else { "~" }, self.branch(child, depth + 1)));
        let below: Vec<String> = below.collect();
        if below.len() == 1 { format!("{frame} > {}", below[0]) } else { format!("{frame} > ({})", below.join(", ")) }
    }

    /// Removes all moving transforms.
    pub(crate) fn remove_moving(&mut self) {
        self.links.retain(|_, link| link.is_fixed);
    }

    /// Removes moving transforms older than `time`.
    pub(crate) fn remove_before(&mut self, time: f64) {
        self.links.values_mut().filter(|l| !l.is_fixed).for_each(|l| l.track.remove_before(time));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn x(x: f64) -> Pose {
        Pose::translation(x, 0.0, 0.0)
    }

    #[test]
    fn transforms_are_chained_up_and_down() {
        let mut tree = TransformTree::default();
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
        let between = |a, b, time| tree.between(a, b, time).map(|pose| pose.translation.x);
        assert!((between("odom", "imu", None).unwrap() - 11.5).abs() < 1e-9 && (between("lidar", "odom", Some(1.05)).unwrap() + 11.5).abs() < 1e-9);
        assert_eq!((between("odom", "lidar", Some(3.0)), between("odom", "camera", None)), (None, None));
        assert!(tree.frames().into_iter().eq(["base", "imu", "lidar", "map", "odom"]));
        assert!(tree.fixed("odom", "lidar").is_none() && tree.moves("lidar") && tree.in_root("lidar", 20.0, 0.0).is_none());
    }

    #[test]
    fn trees_that_are_not_connected_are_drawn() {
        let mut tree = TransformTree::default();
        tree.add("odom", "base", 1.0, x(10.0), false);
        tree.add("base", "imu", 0.0, x(0.5), true);
        tree.add("base", "camera", 0.0, x(0.5), true);
        tree.add("rack", "lidar", 0.0, x(1.0), true);
        assert_eq!(tree.drawing(), "odom > ~base > (camera, imu); rack > lidar");
        assert!(tree.is_apart("lidar") && !tree.is_apart("camera"));
    }

    #[test]
    fn a_cycle_in_the_tree_ends() {
        let mut tree = TransformTree::default();
        tree.add("a", "b", 0.0, x(1.0), true);
        tree.add("b", "a", 0.0, x(1.0), true);
        assert_eq!(tree.ancestors("a").len(), DEEPEST);
        let _ = (tree.in_root("a", 0.0, 0.0), tree.fixed("a", "zzz"));
    }
}
