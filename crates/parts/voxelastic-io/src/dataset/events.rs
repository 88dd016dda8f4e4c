//! The registered cloud list as a stream, decoded ahead.

use super::pose_file::Snapshot;
use super::snapshot::{self, SnapshotContext};
use crate::read_ahead::{IdleStep, ReadAhead};
use crate::scan_list::{Continuation, ScanEdges, ScanEntry};
use crate::stamped_cloud::StampedCloud;
use crate::{Error, Result};
use serde::{Deserialize, Serialize};
use std::collections::{HashMap, HashSet, VecDeque};
use std::io;
use std::sync::Arc;
use voxelastic::Pose;
use voxelastic::event::{Event, NodeId, Scan};

/// Number of clouds that are decoded ahead.
const AHEAD: usize = 2;

/// Iterator over the events of a [`Dataset`](super::Dataset), made by [`Dataset::events`](super::Dataset::events).
#[derive(Debug)]
pub struct Events {
    scans: Arc<[ScanEntry]>,
    edges: Arc<ScanEdges>,
    context: Arc<SnapshotContext>,
    /// Snapshots not yet read, in the order of their scans.
    snapshots: VecDeque<Snapshot>,
    continuation: Continuation,
    /// Indices of the loop edges at each node.
    loops_at: HashMap<NodeId, Vec<usize>>,
    decoded: ReadAhead<Result<StampedCloud>>,
    /// Index of the next scan.
    next: usize,
    /// Index of the last delivered scan.
    previous: Option<usize>,
    delivered: HashSet<NodeId>,
    /// Indices of the scans that could not be read.
    failed: Vec<usize>,
    ready: VecDeque<Result<Event>>,
}

/// Where an [`Events`] is between two scans.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct FolderPosition {
    pub(super) next: usize,
    pub(super) previous: Option<usize>,
    /// Scans that could not be read.
    pub(super) failed: Vec<usize>,
    /// Snapshots not yet read.
    pub(super) snapshots: usize,
    pub(super) continuation: Continuation,
}

impl Events {
    pub(super) fn new(
        scans: Arc<[ScanEntry]>,
        edges: Arc<ScanEdges>,
        context: Arc<SnapshotContext>,
        mut snapshots: VecDeque<Snapshot>,
        from: FolderPosition,
    ) -> Self {
        let entries = Arc::clone(&scans);
        let next = from.next.min(scans.len());
        let decoded =
            ReadAhead::new("voxelastic-decode", AHEAD, (next..scans.len()).map(move |k| entries[k].read()), |what| Err(Error::Panicked { what }));
        snapshots.drain(..snapshots.len().saturating_sub(from.snapshots));
        let delivered = (0..next).filter(|k| !from.failed.contains(k)).map(|k| scans[k].node).collect();
        let mut loops_at: HashMap<NodeId, Vec<usize>> = HashMap::new();
        for (k, edge) in edges.loops.iter().enumerate() {
            loops_at.entry(edge.from).or_default().push(k);
            loops_at.entry(edge.to).or_default().push(k);
        }
        Self {
            scans,
            edges,
            context,
            snapshots,
            continuation: from.continuation,
            loops_at,
            decoded,
            next,
            previous: from.previous.filter(|k| *k < next),
            delivered,
            failed: from.failed,
            ready: VecDeque::new(),
        }
    }

    /// Where it is, if all events of the last scan have been taken.
    pub(crate) fn read_position(&self) -> Option<FolderPosition> {
        let Self { next, previous, failed, snapshots, continuation, .. } = self;
        let position = || FolderPosition {
            next: *next,
            previous: *previous,
            failed: failed.clone(),
            snapshots: snapshots.len(),
            continuation: continuation.clone(),
        };
        self.ready.is_empty().then(position)
    }

    /// A function that decodes one scan ahead in the time of the calling thread, see [`IdleStep`].
    pub fn idle_step(&mut self) -> IdleStep {
        self.decoded.idle_step()
    }

    /// Queues the events of a scan: the scan, its odometry, and loop edges whose scans are both delivered.
    fn deliver(&mut self, k: usize, decoded: StampedCloud) {
        let scans = Arc::clone(&self.scans);
        let entry = &scans[k];
        let cloud = self.context.with_motion(decoded.relative_to(entry.time, self.context.sweeps), entry);
        let t_map_lidar = self.pose(k);
        self.ready.push_back(Ok(Event::Scan(Scan { node: entry.node, time: entry.time, t_map_lidar, cloud })));
        if let Some(previous) = self.previous {
            let odometry = self.edges.odometry(&scans[previous], entry);
            self.ready.extend(odometry.into_iter().map(|e| Ok(Event::OdometryEdge(e))));
        }
        self.previous = Some(k);
        self.delivered.insert(entry.node);
        for k in self.loops_at.get(&entry.node).into_iter().flatten() {
            let edge = &self.edges.loops[*k];
            if self.delivered.contains(&edge.from) && self.delivered.contains(&edge.to) {
                self.ready.push_back(Ok(Event::LoopEdge(edge.clone())));
            }
        }
    }

    /// Pose of scan `k`: as in the file, or continued from the last correction.
    fn pose(&mut self, k: usize) -> Pose {
        let (scans, reported) = (&self.scans, &self.scans[k].t_map_lidar);
        let Some(previous) = self.previous else { return *reported };
        let measured = self.edges.measured(&scans[previous], &scans[k]);
        // Without a measurement, the previous step is the best estimate of the motion.
        let motion = measured.or_else(|| Some(scans[previous.checked_sub(1)?].t_map_lidar.inv_mul(&scans[previous].t_map_lidar)));
        self.continuation.pose(reported, &scans[previous].t_map_lidar, motion.as_ref())
    }

    /// Queues the snapshots that were taken before the next scan.
    fn queue_snapshots(&mut self) {
        let next = self.scans.get(self.next).map(|s| s.node);
        while let Some(snapshot) = self.snapshots.pop_front_if(|s| next.is_none_or(|node| s.after < node)) {
            let update = snapshot::read(&snapshot, &self.context, &self.delivered);
            // The correction is that of the last scan that the snapshot covers.
            let delivered = self.previous.map_or(&[][..], |previous| &self.scans[..=previous]);
            let corrected = |scan: &ScanEntry| update.as_ref().ok()?.iter().rev().find(|(node, _)| *node == scan.node).map(|(_, pose)| *pose);
            if let Some((scan, corrected)) = delivered.iter().rev().find_map(|scan| Some((scan, corrected(scan)?))) {
                self.continuation.corrected(&scan.t_map_lidar, &corrected);
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
                Some(Ok(cloud)) => self.deliver(k, cloud),
                Some(Err(error)) => {
                    self.failed.push(k);
                    self.ready.push_back(Err(error));
                }
                None => {
                    let error = Error::io(&self.scans[k].path, "read", io::Error::other("decoding has stopped"));
                    self.ready.push_back(Err(error));
                    self.next = self.scans.len();
                    break;
                }
            }
            self.next += 1;
            if !self.delivered.is_empty() {
                self.queue_snapshots();
            }
        }
        self.ready.pop_front()
    }
}
