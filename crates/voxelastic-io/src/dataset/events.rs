//! The registered cloud list as a stream, decoded ahead.

use super::folder::Snapshot;
use super::onward::Onward;
use super::{Dataset, ScanEntry, snapshot};
use crate::read_ahead::ReadAhead;
use crate::{Error, Result, StampedCloud};
use std::collections::{HashMap, HashSet, VecDeque};
use std::io;
use std::sync::Arc;
use voxelastic::event::{Event, NodeId, Scan};
use voxelastic::mapper::Chore;
use voxelastic::{Cloud, Pose};

/// Clouds that wait decoded for their turn.
const AHEAD: usize = 2;
/// A cloud's own stamp this far from the time of its scan is of another clock, seconds.
const SAME_CLOCK_S: f64 = 1.0;

/// Iterator over the events of a [`Dataset`], made by [`Dataset::events`].
#[derive(Debug)]
pub struct Events {
    scans: Arc<[ScanEntry]>,
    edges: Arc<super::Edges>,
    context: Arc<snapshot::Context>,
    /// Snapshots not yet read, in the order of their scans.
    snapshots: VecDeque<Snapshot>,
    onward: Onward,
    /// Numbers of the loop edges at each node.
    loops_at: HashMap<NodeId, Vec<usize>>,
    decoded: ReadAhead<Result<StampedCloud>>,
    /// The scan that comes next.
    next: usize,
    /// The last scan that was delivered.
    previous: Option<usize>,
    seen: HashSet<NodeId>,
    ready: VecDeque<Result<Event>>,
}

impl Events {
    pub(super) fn new(dataset: &Dataset) -> Self {
        let scans = Arc::clone(&dataset.scans);
        let decoded = ReadAhead::new("voxelastic-decode", AHEAD, (0..scans.len()).map(move |k| scans[k].read()));
        let mut loops_at: HashMap<NodeId, Vec<usize>> = HashMap::new();
        for (k, edge) in dataset.edges.loops.iter().enumerate() {
            loops_at.entry(edge.from).or_default().push(k);
            loops_at.entry(edge.to).or_default().push(k);
        }
        Self {
            scans: Arc::clone(&dataset.scans),
            edges: Arc::clone(&dataset.edges),
            context: Arc::clone(&dataset.context),
            snapshots: dataset.snapshots.iter().cloned().collect(),
            onward: Onward::new(),
            loops_at,
            decoded,
            next: 0,
            previous: None,
            seen: HashSet::new(),
            ready: VecDeque::new(),
        }
    }

    /// Decoding one scan ahead, for threads with time to spare. Taken before the first event, there is no thread that decodes.
    pub fn chore(&mut self) -> Chore {
        self.decoded.chore()
    }

    /// Queues a scan and what becomes known with it.
    fn arrive(&mut self, k: usize, decoded: StampedCloud) {
        let scans = Arc::clone(&self.scans);
        let entry = &scans[k];
        let cloud = self.context.in_motion(in_scan_time(decoded, entry.time), entry);
        let t_map_lidar = self.pose(k);
        self.ready.push_back(Ok(Event::Scan(Scan { node: entry.node, time: entry.time, t_map_lidar, cloud })));
        if let Some(previous) = self.previous {
            let odometry = self.edges.odometry(&scans[previous], entry);
            self.ready.extend(odometry.into_iter().map(|e| Ok(Event::OdometryEdge(e))));
        }
        self.previous = Some(k);
        self.seen.insert(entry.node);
        for k in self.loops_at.get(&entry.node).into_iter().flatten() {
            let edge = &self.edges.loops[*k];
            if self.seen.contains(&edge.from) && self.seen.contains(&edge.to) {
                self.ready.push_back(Ok(Event::LoopEdge(edge.clone())));
            }
        }
    }

    /// Pose of scan `k`: as the file says, or on from the last correction.
    fn pose(&mut self, k: usize) -> Pose {
        let (scans, told) = (&self.scans, &self.scans[k].t_map_lidar);
        let Some(previous) = self.previous else { return *told };
        let measured = self.edges.measured(&scans[previous], &scans[k]);
        // Without a measurement, the motion before it is the best guess.
        let motion = measured.or_else(|| Some(scans[previous.checked_sub(1)?].t_map_lidar.inv_mul(&scans[previous].t_map_lidar)));
        self.onward.pose(told, &scans[previous].t_map_lidar, motion.as_ref())
    }

    /// Queues the snapshots that were taken before the scan that comes next.
    fn update_poses(&mut self) {
        let coming = self.scans.get(self.next).map(|s| s.node);
        while let Some(snapshot) = self.snapshots.pop_front_if(|s| coming.is_none_or(|node| s.after < node)) {
            let update = snapshot::read(&snapshot, &self.context, &self.seen);
            // The last scan that it is about.
            let seen = self.previous.map_or(&[][..], |previous| &self.scans[..=previous]);
            let now = |scan: &ScanEntry| update.as_ref().ok()?.iter().rev().find(|(node, _)| *node == scan.node).map(|(_, pose)| *pose);
            if let Some((scan, now)) = seen.iter().rev().find_map(|scan| Some((scan, now(scan)?))) {
                self.onward.corrected(&scan.t_map_lidar, &now);
            }
            self.ready.push_back(update.map(Event::PoseUpdate));
        }
    }
}

impl Iterator for Events {
    type Item = Result<Event>;

    fn next(&mut self) -> Option<Self::Item> {
        while self.ready.is_empty() && self.next < self.scans.len() {
            let k = self.next;
            match self.decoded.next() {
                Some(Ok(cloud)) => self.arrive(k, cloud),
                Some(Err(error)) => self.ready.push_back(Err(error)),
                None => {
                    let error = Error::io(&self.scans[k].path, "read", io::Error::other("decoding has stopped"));
                    self.ready.push_back(Err(error));
                    self.next = self.scans.len();
                    break;
                }
            }
            self.next += 1;
            if !self.seen.is_empty() {
                self.update_poses();
            }
        }
        self.ready.pop_front()
    }
}

/// The cloud with its times counted from the scan's time, if the cloud's own stamp is of the same clock.
pub(crate) fn in_scan_time(decoded: StampedCloud, time: f64) -> Cloud {
    let StampedCloud { mut cloud, stamp } = decoded;
    if let (Some(times), Some(shift)) = (&mut cloud.time, stamp.map(|s| s - time).filter(|d| d.abs() <= SAME_CLOCK_S)) {
        times.iter_mut().for_each(|t| *t += shift as f32);
    }
    cloud
}
