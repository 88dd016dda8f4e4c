//! The poses of the scans as a path, of bounded length: a robot that drives for hours does not send more every second.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};
use voxelastic::Pose;
use voxelastic::atlas::Atlas;
use voxelastic::event::NodeId;

/// Poses of a published path.
const MOST_POSES: usize = 4096;

/// When a path is published, and which.
#[derive(Debug)]
pub struct PathState {
    most: usize,
    /// Time stamps of the scans that a path may have, seconds.
    times: BTreeMap<NodeId, f64>,
    /// When the last path was published, and of which poses.
    published: Option<(Instant, Vec<(f64, Pose)>)>,
    /// Scans in the map when it was looked at last.
    scans: usize,
}

impl Default for PathState {
    fn default() -> Self {
        Self::of(MOST_POSES)
    }
}

impl PathState {
    fn of(most: usize) -> Self {
        Self { most, times: BTreeMap::new(), published: None, scans: 0 }
    }

    /// Notes the time stamp of a scan, seconds.
    pub fn add(&mut self, node: NodeId, time: f64) {
        self.times.insert(node, time);
    }

    /// The last pose that was published.
    pub fn last(&self) -> Option<&Pose> {
        self.published.as_ref().and_then(|(_, path)| path.last()).map(|(_, pose)| pose)
    }

    /// The next path is published in any case.
    pub fn repeat(&mut self) {
        self.published = None;
    }

    /// The path to publish after an event, if it is another than the last one: at once if no scan was added, else once in `period`.
    pub fn step(&mut self, atlas: &Atlas, period: Duration) -> Option<&[(f64, Pose)]> {
        let scans = atlas.scan_count();
        let has_same_scans = std::mem::replace(&mut self.scans, scans) == scans;
        let is_due = self.published.as_ref().is_none_or(|(at, _)| has_same_scans || at.elapsed() >= period);
        if !is_due {
            return None;
        }
        let path = self.path(atlas);
        if self.published.as_ref().is_some_and(|(_, before)| *before == path) {
            return None;
        }
        Some(&self.published.insert((Instant::now(), path)).1)
    }

    /// The time stamp of a scan; of one that is not known any more, that of the nearest scan before it.
    fn time(&self, node: NodeId) -> f64 {
        self.times.range(..=node).next_back().map_or(0.0, |(_, time)| *time)
    }

    /// The scans in the order of their nodes, in the map frame: all of them, or every second, fourth, ... and the last one where there are too many.
    fn path(&mut self, atlas: &Atlas) -> Vec<(f64, Pose)> {
        let mut nodes: Vec<NodeId> = atlas.placed().flat_map(|(submap, _)| submap.scans().iter().map(|scan| scan.node)).collect();
        nodes.sort_unstable();
        let step = nodes.len().div_ceil(self.most.max(1)).next_power_of_two();
        let last = nodes.last().copied();
        let chosen: Vec<NodeId> = nodes.into_iter().step_by(step).collect();
        let mut path: Vec<(NodeId, Pose)> = Vec::with_capacity(chosen.len() + 1);
        for (submap, t_map_submap) in atlas.placed() {
            let scans = submap.scans().iter().filter(|scan| Some(scan.node) == last || chosen.binary_search(&scan.node).is_ok());
            path.extend(scans.map(|scan| (scan.node, t_map_submap * scan.t_submap_lidar)));
        }
        path.sort_unstable_by_key(|(node, _)| *node);
        // Longer paths have none of those that this one leaves out.
        if self.times.len() > 2 * self.most {
            self.times.retain(|node, _| chosen.binary_search(node).is_ok() || Some(*node) >= last);
        }
        path.into_iter().map(|(node, pose)| (self.time(node), pose)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use voxelastic::event::{Event, Scan};
    use voxelastic::{Cloud, Mapper, Settings};
    use voxelastic_sim::{SimOptions, Simulation};

    /// A scan of a room: what is in it does not matter here.
    fn room() -> Cloud {
        Simulation::new(SimOptions { scans: Some(1), columns: Some(128), ..SimOptions::of("room") }).unwrap().cloud(0).unwrap()
    }

    fn x(x: f64) -> Pose {
        Pose::translation(x, 0.0, 0.0)
    }

    fn places(path: Option<&[(f64, Pose)]>) -> Vec<(f64, f64)> {
        path.unwrap_or_default().iter().map(|(time, pose)| (*time, pose.translation.x)).collect()
    }

    #[test]
    fn a_path_is_thinned_where_it_would_be_too_long() {
        let mut mapper = Mapper::new(Settings { voxel_size: 0.5, ..Settings::default() }).unwrap();
        let (mut state, room) = (PathState::of(4), room());
        let mut drive = |state: &mut PathState, node: NodeId| {
            state.add(node, 100.0 + node as f64);
            let cloud = room.clone();
            mapper.handle(Event::Scan(Scan { node, time: 100.0 + node as f64, t_map_lidar: x(node as f64), cloud })).unwrap();
            (places(state.step(mapper.atlas(), Duration::ZERO)), mapper.atlas().scan_pose(node).unwrap().translation.x)
        };
        let mut last = Vec::new();
        for node in 0..4 {
            last = drive(&mut state, node).0;
        }
        assert_eq!(last, [(100.0, 0.0), (101.0, 1.0), (102.0, 2.0), (103.0, 3.0)]);
        assert_eq!(drive(&mut state, 4).0, [(100.0, 0.0), (102.0, 2.0), (104.0, 4.0)]);
        for node in 5..20 {
            let (path, newest) = drive(&mut state, node);
            assert!(path.len() <= 5 && path.first() == Some(&(100.0, 0.0)), "{path:?}");
            assert_eq!(path.last(), Some(&(100.0 + node as f64, newest)), "the robot is at the end");
            assert!(path.iter().all(|(time, x)| (time - 100.0 - x).abs() < 1e-9), "each with its own time: {path:?}");
            assert!(state.times.len() <= 9, "times of scans that no path has any more are kept");
        }
        assert_eq!(state.last().unwrap().translation.x, 19.0);
    }

    #[test]
    fn corrections_are_published_at_once_and_scans_now_and_then() {
        let mut mapper = Mapper::new(Settings { voxel_size: 0.5, ..Settings::default() }).unwrap();
        let (mut state, period) = (PathState::default(), Duration::from_secs(3600));
        for node in 0..3 {
            mapper.handle(Event::Scan(Scan { node, time: 0.0, t_map_lidar: x(node as f64), cloud: room() })).unwrap();
            assert_eq!(state.step(mapper.atlas(), period).is_some(), node == 0, "scan {node}");
        }
        mapper.handle(Event::PoseUpdate((0..3).map(|node| (node, x(node as f64 + 5.0))).collect())).unwrap();
        let path = places(state.step(mapper.atlas(), period));
        assert_eq!(path.iter().map(|(_, x)| *x).collect::<Vec<_>>(), [5.0, 6.0, 7.0]);
        assert!(state.step(mapper.atlas(), period).is_none(), "nothing new");
        state.repeat();
        assert!(state.step(mapper.atlas(), period).is_some());
    }
}
