//! Scans and poses by time into registered scans.

use super::corrections::{Correction, Corrections};
use super::select::{Ledger, Selection, Taken};
use super::track::{LONGEST_GAP_S, Track, Tree};
use super::{Heard, HeardCloud, Tape, sweep};
use crate::dataset::{Edges, Onward, Picker, ScanEntry, in_scan_time};
use crate::{Error, Result};
use std::collections::{HashMap, HashSet, VecDeque};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use voxelastic::event::{Edge, Event, NodeId, Scan};
use voxelastic::{Cloud, Motion, Pose};

/// A scan waits this long for its pose, in seconds of recording.
const PATIENCE_S: f64 = 6.0;
/// Scans that wait hold no more bytes than this; else the first is given up.
const MOST_WAITING: usize = 1 << 30;
/// Poses older than this before the first scan that waits are forgotten, seconds.
const MEMORY_S: f64 = 30.0;

/// Until a scan was decoded, its points are taken to be from this long behind its stamp, seconds: most sensors turn ten times a second.
const SWEEP_S: f64 = 0.1;

/// Where the poses come from.
pub(crate) enum Poses {
    /// They are all known.
    Given(Track),
    /// They are heard; the frame that the last one was of.
    Heard { track: Track, child: String },
    /// The transform tree has them.
    Tree,
}

/// How a tape is played.
pub(crate) struct PlayerOptions {
    /// The recording, for messages.
    pub(crate) path: PathBuf,
    pub(crate) poses: Poses,
    /// Pose of the lidar on the vehicle, if the user gave it.
    pub(crate) t_base_lidar: Option<Pose>,
    pub(crate) picker: Picker,
    pub(crate) selection: Selection,
    /// Scans at known times that are nodes of a graph, with the graph's edges: no others are taken then.
    pub(crate) nodes: Option<(Vec<ScanEntry>, Edges)>,
    /// Corrected poses that become known on the way.
    pub(crate) corrections: Corrections,
    /// How far in time a pose may be from its scan, seconds.
    pub(crate) tolerance_s: f64,
    /// Whether clouds are told how the lidar moved while they were taken.
    pub(crate) deskew: bool,
    pub(crate) ledger: Arc<Ledger>,
}

struct Waiting {
    cloud: HeardCloud,
    /// Place among all clouds of the recording.
    index: u64,
    /// When it was heard.
    since: f64,
}

/// Plays a tape: an iterator over the registered cloud list.
pub(crate) struct Player {
    tape: Box<dyn Tape>,
    options: PlayerOptions,
    tree: Tree,
    /// Pose of the lidar in the frame of the poses, once it is known.
    t_child_lidar: Option<Pose>,
    waiting: VecDeque<Waiting>,
    waiting_bytes: usize,
    clouds: u64,
    counts: Vec<usize>,
    /// Clouds without a pose, and the time of the first.
    lost: (usize, f64),
    /// Longest time behind a scan's stamp that its points were from, seconds.
    sweep: f64,
    /// The last scan that was delivered, with the pose that was told of it, and the way to it from the one before.
    previous: Option<ScanEntry>,
    step: Option<Pose>,
    onward: Onward,
    seen: HashSet<NodeId>,
    loops_at: HashMap<NodeId, Vec<usize>>,
    ready: VecDeque<Result<Event>>,
    ended: bool,
}

impl Player {
    pub(crate) fn new(tape: Box<dyn Tape>, options: PlayerOptions) -> Self {
        let mut loops_at: HashMap<NodeId, Vec<usize>> = HashMap::new();
        for (k, edge) in options.nodes.iter().flat_map(|(_, edges)| edges.loops.iter().enumerate()) {
            loops_at.entry(edge.from).or_default().push(k);
            loops_at.entry(edge.to).or_default().push(k);
        }
        Self {
            tape,
            options,
            tree: Tree::default(),
            t_child_lidar: None,
            waiting: VecDeque::new(),
            waiting_bytes: 0,
            clouds: 0,
            counts: Vec::new(),
            lost: (0, 0.0),
            sweep: SWEEP_S,
            previous: None,
            step: None,
            onward: Onward::new(),
            seen: HashSet::new(),
            loops_at,
            ready: VecDeque::new(),
            ended: false,
        }
    }

    /// Takes in what comes next on the tape.
    fn hear(&mut self) {
        match self.tape.next() {
            None => self.ended = true,
            Some(Err(error)) => self.ready.push_back(Err(error)),
            Some(Ok(Heard::Nothing)) => {}
            Some(Ok(Heard::Transform { time, parent, child, pose, is_fixed })) => self.tree.add(&parent, &child, time, pose, is_fixed),
            Some(Ok(Heard::Pose { time, child: of, pose })) => {
                if let Poses::Heard { track, child } = &mut self.options.poses {
                    track.add(time, pose);
                    *child = of;
                }
            }
            Some(Ok(Heard::Cloud(cloud))) => {
                self.waiting_bytes += cloud.bytes;
                self.waiting.push_back(Waiting { cloud, index: self.clouds, since: self.tape.now() });
                self.clouds += 1;
            }
        }
        self.options.ledger.reach(self.tape.now());
    }

    /// Whether everything is known about the first scan that waits that will ever be.
    fn is_settled(&self) -> bool {
        let Some(first) = self.waiting.front() else { return false };
        let needed = first.cloud.time + self.sweep;
        let known_until = match &self.options.poses {
            Poses::Given(_) => Some(f64::INFINITY),
            Poses::Heard { track, .. } => track.newest(),
            Poses::Tree => self.tree.newest(&first.cloud.frame),
        };
        self.ended
            || known_until.is_some_and(|known| known >= needed)
            || self.tape.now() - first.since > PATIENCE_S
            || self.waiting_bytes > MOST_WAITING
    }

    /// Pose of the lidar at a time.
    fn pose_at(&mut self, time: f64, frame: &str) -> Option<Pose> {
        let tolerance = self.options.tolerance_s;
        let (pose, child) = match &self.options.poses {
            Poses::Tree => return self.tree.in_root(frame, time, tolerance),
            Poses::Given(track) => (track.at(time, LONGEST_GAP_S, tolerance)?, ""),
            Poses::Heard { track, child } => (track.at(time, LONGEST_GAP_S, tolerance)?, child.as_str()),
        };
        let t_child_lidar = *self.t_child_lidar.get_or_insert_with(|| mounting(&self.tree, child, frame, self.options.t_base_lidar));
        Some(pose * t_child_lidar)
    }

    /// Deals with the first scan that waits.
    fn settle(&mut self) {
        let Some(Waiting { cloud, index, .. }) = self.waiting.pop_front() else { return };
        self.waiting_bytes -= cloud.bytes;
        self.forget(cloud.time - MEMORY_S);
        let Some(t_map_lidar) = self.pose_at(cloud.time, &cloud.frame) else {
            self.lost = (self.lost.0 + 1, if self.lost.0 == 0 { cloud.time } else { self.lost.1 });
            self.options.ledger.without_pose.fetch_add(1, Ordering::Relaxed);
            return;
        };
        let Some(entry) = self.entry(index, cloud.time, t_map_lidar) else { return };
        if !self.options.picker.takes(&entry) {
            return;
        }
        if !self.options.selection.takes(&mut self.counts) {
            self.options.ledger.left_out.fetch_add(1, Ordering::Relaxed);
            return;
        }
        let HeardCloud { decode, frame, .. } = cloud;
        match decode() {
            Ok(decoded) => {
                let mut cloud = in_scan_time(decoded, entry.time);
                cloud.motion = self.motion(&cloud, &entry, &frame);
                self.options.ledger.note(entry.node, Taken { index, motion: cloud.motion.clone() });
                self.arrive(entry, cloud);
            }
            Err(error) => self.ready.push_back(Err(error)),
        }
    }

    /// How the lidar moved during a sweep whose points have times, if poses are known from its beginning to its end.
    fn motion(&mut self, cloud: &Cloud, entry: &ScanEntry, frame: &str) -> Option<Motion> {
        let (_, high) = sweep::span(cloud).filter(|_| self.options.deskew)?;
        self.sweep = self.sweep.max(f64::from(high));
        sweep::motion(cloud, entry.time, &entry.t_map_lidar, |time| self.pose_at(time, frame))
    }

    /// The scan as a node; none if it is none of the graph's.
    fn entry(&self, index: u64, time: f64, t_map_lidar: Pose) -> Option<ScanEntry> {
        let Some((nodes, _)) = &self.options.nodes else {
            return Some(ScanEntry { path: self.options.path.clone(), index: index as usize, node: index, time, t_map_lidar });
        };
        let tolerance = self.options.tolerance_s;
        let k = nodes.partition_point(|n| n.time < time - tolerance);
        let node = nodes.get(k).filter(|n| n.time <= time + tolerance && !self.seen.contains(&n.node))?;
        Some(ScanEntry { index: index as usize, time, t_map_lidar, ..node.clone() })
    }

    /// Queues a scan and what becomes known with it.
    fn arrive(&mut self, entry: ScanEntry, cloud: Cloud) {
        self.correct(entry.time);
        self.options.corrections.note(entry.time, entry.node, entry.t_map_lidar);
        let t_map_lidar = self.corrected(&entry.t_map_lidar);
        self.ready.push_back(Ok(Event::Scan(Scan { node: entry.node, time: entry.time, t_map_lidar, cloud })));
        let edges = self.options.nodes.as_ref().map(|(_, edges)| edges);
        if let Some(previous) = &self.previous {
            let odometry = match edges {
                Some(edges) => edges.odometry(previous, &entry),
                None => {
                    let t_from_to = previous.t_map_lidar.inv_mul(&entry.t_map_lidar);
                    vec![Edge { from: previous.node, to: entry.node, t_from_to, information: None }]
                }
            };
            self.ready.extend(odometry.into_iter().map(|e| Ok(Event::OdometryEdge(e))));
        }
        self.seen.insert(entry.node);
        let loops = edges.map_or(&[][..], |edges| &edges.loops);
        for edge in self.loops_at.get(&entry.node).into_iter().flatten().filter_map(|k| loops.get(*k)) {
            if self.seen.contains(&edge.from) && self.seen.contains(&edge.to) {
                self.ready.push_back(Ok(Event::LoopEdge(edge.clone())));
            }
        }
        self.previous = Some(entry);
    }

    /// Pose of the scan that comes next, of which `told` is told: the same, or on from the last correction.
    fn corrected(&mut self, told: &Pose) -> Pose {
        let Some(previous) = &self.previous else { return *told };
        let last = previous.t_map_lidar;
        // Nothing measures the motion; that before it is the best guess.
        let step = self.step.replace(last.inv_mul(told));
        self.onward.pose(told, &last, step.as_ref())
    }

    /// Queues the corrections that became known before `time`.
    fn correct(&mut self, time: f64) {
        while let Some(path) = self.options.corrections.due(time) {
            // In a transform tree scans have poses of their own, and nobody says whose a file's are.
            let t_child_lidar = self.t_child_lidar.or(self.options.t_base_lidar).unwrap_or_default();
            let correction = self.options.corrections.read(&path, &t_child_lidar, self.options.tolerance_s);
            if let Ok(Correction { told, now, .. }) = &correction {
                self.onward.corrected(told, now);
            }
            self.ready.push_back(correction.map(|c| Event::PoseUpdate(c.poses)));
        }
    }

    fn forget(&mut self, before: f64) {
        self.tree.forget_before(before);
        if let Poses::Heard { track, .. } = &mut self.options.poses {
            track.forget_before(before);
        }
    }

    /// Says at the end what was left out for want of a pose.
    fn report_lost(&mut self) {
        let (count, first) = std::mem::take(&mut self.lost);
        if count > 0 {
            let problem = format!("{count} of {} clouds have no pose, the first at {first:.3} s", self.clouds);
            let remedy = "they lie before, after or between the poses: choose others with --pose-topic or --poses";
            self.ready.push_back(Err(Error::dataset(&self.options.path, problem, remedy)));
        }
    }
}

impl Iterator for Player {
    type Item = Result<Event>;

    fn next(&mut self) -> Option<Result<Event>> {
        while self.ready.is_empty() {
            if self.options.selection.is_done(&self.counts) {
                break;
            } else if self.is_settled() {
                self.settle();
            } else if self.ended {
                self.correct(f64::INFINITY);
                self.report_lost();
                break;
            } else {
                self.hear();
            }
        }
        self.ready.pop_front()
    }
}

/// Pose of the lidar in the frame that the poses are of: as the user says, else as the fixed transforms say, else the same.
fn mounting(tree: &Tree, child: &str, lidar: &str, given: Option<Pose>) -> Pose {
    if let Some(pose) = given {
        return pose;
    }
    if child.is_empty() || child == lidar {
        return Pose::identity();
    }
    tree.fixed(child, lidar).unwrap_or_else(|| {
        tracing::warn!("no fixed transform leads from {child} to {lidar}: the poses are taken as those of the lidar (--t-base-lidar says otherwise)");
        Pose::identity()
    })
}
