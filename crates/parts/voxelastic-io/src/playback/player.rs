//! Turns the messages of a recording into registered scans.

use super::clock_watch::ClockWatch;
use super::corrections::{Correction, Corrections};
use super::message_stream::{CloudMessage, MessageStream, SensorMessage};
use super::playback_log::{DeliveredScan, PlaybackLog, ReportedPose};
use super::pose_lookup::{PoseLookup, PoseSource, SensorMounts};
use super::robot_mounts::RobotMounts;
use super::selection::Selection;
use crate::motion::{PoseTrack, sweep_motion, take_back, time_span};
use crate::scan_list::{Continuation, KeyframeFilter, NODES_OF_SENSOR, ScanEdges, ScanEntry};
use crate::{Error, Result};
use std::collections::{BTreeMap, HashMap, HashSet, VecDeque};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use voxelastic::event::{Edge, Event, NodeId, Scan};
use voxelastic::geometry::PoseChange;
use voxelastic::{Cloud, Motion, Pose};

/// A scan waits at most this long for its pose, in seconds of recording.
const LONGEST_WAIT_S: f64 = 6.0;
/// Waiting scans hold at most this much memory, bytes; beyond it the first is processed with what is known.
const MOST_WAITING_BYTES: usize = 1 << 30;
/// Poses older than this before the first waiting scan are removed, seconds.
const POSE_MEMORY_S: f64 = 30.0;
/// Assumed duration of a sweep until a scan has been decoded, seconds: most sensors turn ten times a second.
const SWEEP_S: f64 = 0.1;

/// How a recording is played.
pub(crate) struct PlayerOptions {
    /// The recording, for messages.
    pub(crate) path: PathBuf,
    pub(crate) poses: PoseSource,
    pub(crate) mounts: SensorMounts,
    /// Each sensor has one of its own.
    pub(crate) keyframes: KeyframeFilter,
    pub(crate) selection: Selection,
    /// Scans at known times that are nodes of a graph, with the graph's edges. Other scans are then not taken.
    pub(crate) nodes: Option<(Vec<ScanEntry>, ScanEdges)>,
    /// Corrected poses that become known during the recording.
    pub(crate) corrections: Corrections,
    /// What to read otherwise of poses that come, and of corrected ones.
    pub(crate) pose_change: PoseChange,
    /// How far in time a pose may be from its scan, seconds.
    pub(crate) tolerance_s: f64,
    /// Whether clouds get the lidar's motion during their sweep.
    pub(crate) deskew: bool,
    pub(crate) log: Arc<PlaybackLog>,
    /// After so many seconds the place of a robot's lidar is assumed; none: never.
    pub(crate) mount_timeout_s: Option<f64>,
}

/// What is kept of each sensor.
struct SensorTrail {
    keyframes: KeyframeFilter,
    /// State of the selection.
    selected: Vec<usize>,
    /// Clouds read so far.
    clouds: u64,
    /// The last delivered scan, with its reported pose, and the motion to it from the scan before.
    previous: Option<ScanEntry>,
    step: Option<Pose>,
}

/// A scan that waits for its pose.
struct WaitingScan {
    cloud: CloudMessage,
    /// Index among all clouds of the recording.
    index: u64,
    node: NodeId,
    /// Recording time of its message, seconds.
    since: f64,
}

/// What a step of a player came to.
#[derive(Debug)]
pub enum Polled<T> {
    /// Something for the caller.
    Item(T),
    /// Nothing yet: another step is needed.
    Nothing,
    /// There will be no more.
    End,
}

/// Iterator over the registered cloud list of a recording.
pub(crate) struct Player {
    stream: ClockWatch,
    path: PathBuf,
    poses: PoseLookup,
    keyframes: KeyframeFilter,
    sensors: BTreeMap<u16, SensorTrail>,
    selection: Selection,
    nodes: Option<(Vec<ScanEntry>, ScanEdges)>,
    corrections: Corrections,
    pose_change: PoseChange,
    tolerance_s: f64,
    deskew: bool,
    log: Arc<PlaybackLog>,
    /// Of a robot that runs.
    robot: Option<RobotMounts>,
    waiting: VecDeque<WaitingScan>,
    waiting_bytes: usize,
    /// Clouds read so far.
    clouds: u64,
    /// State of the selection.
    selected: Vec<usize>,
    /// Clouds without a pose, and the time of the first.
    without_pose: (usize, f64),
    /// Why the last of these has none, if that is known.
    reason: Option<String>,
    /// Longest time from a scan's stamp to its last point so far, seconds.
    sweep_s: f64,
    /// The sensor of the last delivered scan.
    latest: Option<u16>,
    continuation: Continuation,
    /// Nodes of the graph that were delivered, if there is a graph.
    delivered: HashSet<NodeId>,
    /// Indices of the loop edges at each node.
    loops_at: HashMap<NodeId, Vec<usize>>,
    ready: VecDeque<Result<Event>>,
    ended: bool,
}

impl Player {
    pub(crate) fn new(stream: Box<dyn MessageStream>, options: PlayerOptions) -> Self {
        let mut loops_at: HashMap<NodeId, Vec<usize>> = HashMap::new();
        for (k, edge) in options.nodes.iter().flat_map(|(_, edges)| edges.loops.iter().enumerate()) {
            loops_at.entry(edge.from).or_default().push(k);
            loops_at.entry(edge.to).or_default().push(k);
        }
        Self {
            stream: ClockWatch::new(stream),
            path: options.path,
            robot: options.mounts.is_live.then(|| RobotMounts::new(options.mount_timeout_s)),
            poses: PoseLookup::new(options.poses, options.mounts, options.pose_change, options.tolerance_s),
            keyframes: options.keyframes,
            sensors: BTreeMap::new(),
            selection: options.selection,
            nodes: options.nodes,
            corrections: options.corrections,
            pose_change: options.pose_change,
            tolerance_s: options.tolerance_s,
            deskew: options.deskew,
            log: options.log,
            waiting: VecDeque::new(),
            waiting_bytes: 0,
            clouds: 0,
            selected: Vec::new(),
            without_pose: (0, 0.0),
            reason: None,
            sweep_s: SWEEP_S,
            latest: None,
            continuation: Continuation::new(),
            delivered: HashSet::new(),
            loops_at,
            ready: VecDeque::new(),
            ended: false,
        }
    }

    /// Reads the next message.
    fn read_message(&mut self) {
        match self.stream.next() {
            None => self.ended = true,
            Some(Err(error)) => self.ready.push_back(Err(error)),
            Some(Ok(SensorMessage::Cloud(cloud))) => {
                let (now, log) = (self.stream.now(), &self.log);
                let is_kept = self.robot.as_mut().is_none_or(|robot| robot.look(&self.poses, (&cloud.frame, cloud.sensor), now, log));
                if !is_kept {
                    return self.leave_without_pose(&cloud);
                }
                self.waiting_bytes += cloud.bytes;
                let trail = self.trail(cloud.sensor);
                trail.clouds += 1;
                let node = NodeId::from(cloud.sensor) * NODES_OF_SENSOR + trail.clouds - 1;
                self.waiting.push_back(WaitingScan { cloud, index: self.clouds, node, since: self.stream.now() });
                self.clouds += 1;
            }
            Some(Ok(SensorMessage::Corrected(track))) => self.correct(&track),
            Some(Ok(SensorMessage::ClockJump)) => {
                // What waits is of before: poses that come now must not be taken for its own.
                while !self.waiting.is_empty() {
                    self.process_first();
                }
                self.poses.add(SensorMessage::ClockJump);
            }
            Some(Ok(message)) => {
                let is_fixed = matches!(message, SensorMessage::Transform { is_fixed: true, .. });
                self.poses.add(message);
                if is_fixed {
                    self.remount();
                }
            }
        }
        self.log.set_now(self.stream.now());
    }

    fn trail(&mut self, sensor: u16) -> &mut SensorTrail {
        let keyframes = self.keyframes;
        self.sensors.entry(sensor).or_insert_with(|| SensorTrail { keyframes, selected: Vec::new(), clouds: 0, previous: None, step: None })
    }

    /// Whether the first waiting scan need not wait any longer: its poses are complete and where the lidar is is known, or waiting has reached a limit.
    fn is_first_due(&self) -> bool {
        let Some(first) = self.waiting.front() else { return false };
        let needed = if self.deskew && first.cloud.has_times { first.cloud.time + self.sweep_s } else { first.cloud.time };
        self.ended
            || self.poses.known_until(&first.cloud.frame).is_some_and(|known| known >= needed)
                && self.poses.is_mounted(&first.cloud.frame, first.cloud.sensor)
            || self.stream.now() - first.since > LONGEST_WAIT_S
            || self.waiting_bytes > MOST_WAITING_BYTES
    }

    /// Processes the first waiting scan.
    fn process_first(&mut self) {
        let Some(WaitingScan { cloud, index, node, .. }) = self.waiting.pop_front() else { return };
        self.waiting_bytes -= cloud.bytes;
        self.poses.remove_before(cloud.time - POSE_MEMORY_S);
        let now = self.stream.now();
        if self.robot.as_ref().is_some_and(|robot| !robot.may_map(&self.poses, (&cloud.frame, cloud.sensor), now)) {
            return self.leave_without_pose(&cloud);
        }
        let Some(t_map_lidar) = self.poses.pose_at(cloud.time, &cloud.frame, cloud.sensor) else {
            return self.leave_without_pose(&cloud);
        };
        let Some(entry) = self.entry(index, node, cloud.time, t_map_lidar) else { return };
        let trail = self.trail(cloud.sensor);
        if !trail.keyframes.takes(&entry.t_map_lidar, entry.time) {
            return;
        }
        let mut own = std::mem::take(&mut trail.selected);
        let is_taken = self.selection.takes(&mut self.selected, &mut own);
        self.trail(cloud.sensor).selected = own;
        if !is_taken {
            self.log.left_out.fetch_add(1, Ordering::Relaxed);
            return;
        }
        let CloudMessage { decode, frame, sensor, sweep, .. } = cloud;
        match decode() {
            Ok(decoded) => {
                let mut cloud = decoded.relative_to(entry.time, sweep);
                cloud.sensor = sensor;
                let moved_by = self.poses.is_registered(&frame).then_some(entry.t_map_lidar);
                moved_by.iter().for_each(|t_map_lidar| take_back(&mut cloud, t_map_lidar));
                cloud.motion = self.motion(&cloud, &entry, &frame);
                let t_child_lidar = self.poses.t_child_lidar(&frame, sensor);
                self.log.add(entry.node, DeliveredScan { index, motion: cloud.motion.clone(), moved_by });
                self.deliver(entry, cloud, t_child_lidar);
            }
            Err(error) => self.ready.push_back(Err(error)),
        }
    }

    /// Counts a cloud without a pose.
    fn leave_without_pose(&mut self, cloud: &CloudMessage) {
        let (count, first) = self.without_pose;
        self.without_pose = (count + 1, if count == 0 { cloud.time } else { first });
        self.reason = self.poses.missing(&cloud.frame, cloud.sensor);
        self.log.without_pose.fetch_add(1, Ordering::Relaxed);
    }

    /// Takes places of lidars that have changed, and moves what was delivered.
    fn remount(&mut self) {
        let Some(robot) = &mut self.robot else { return };
        for change in self.poses.remount() {
            self.ready.extend(robot.moved(&change, &self.log).map(Ok));
            self.corrections.remount(change.sensor, &change.t_old_new);
            self.log.remount(change.sensor, &change.t_old_new);
            let previous = self.sensors.get_mut(&change.sensor).and_then(|trail| trail.previous.as_mut());
            previous.into_iter().for_each(|previous| previous.t_map_lidar *= change.t_old_new);
        }
    }

    /// The lidar's motion during a sweep whose points have times, if poses are known from its start to its end.
    fn motion(&mut self, cloud: &Cloud, entry: &ScanEntry, frame: &str) -> Option<Motion> {
        let (_, high) = time_span(cloud).filter(|_| self.deskew)?;
        self.sweep_s = self.sweep_s.max(f64::from(high));
        sweep_motion(cloud, entry.time, &entry.t_map_lidar, |time| self.poses.pose_at(time, frame, cloud.sensor))
    }

    /// The scan as a node; `None` if a graph is given and the scan is not one of its nodes.
    fn entry(&self, index: u64, node: NodeId, time: f64, t_map_lidar: Pose) -> Option<ScanEntry> {
        let Some((nodes, _)) = &self.nodes else {
            return Some(ScanEntry { path: self.path.clone(), index: index as usize, node, time, t_map_lidar, sensor: 0 });
        };
        let tolerance = self.tolerance_s;
        let k = nodes.partition_point(|n| n.time < time - tolerance);
        let node = nodes.get(k).filter(|n| n.time <= time + tolerance && !self.delivered.contains(&n.node))?;
        Some(ScanEntry { index: index as usize, time, t_map_lidar, ..node.clone() })
    }

    /// Queues the events of a scan: corrections known by then, the scan, its odometry, and loop edges whose ends are both delivered.
    fn deliver(&mut self, entry: ScanEntry, cloud: Cloud, t_child_lidar: Pose) {
        let sensor = cloud.sensor;
        self.queue_corrections(entry.time);
        self.corrections.note(entry.time, entry.node, entry.t_map_lidar, t_child_lidar);
        self.log.set_reported(ReportedPose { node: entry.node, time: entry.time, t_odom_lidar: entry.t_map_lidar });
        let t_map_lidar = self.continued(sensor, &entry.t_map_lidar);
        self.robot.iter_mut().for_each(|robot| robot.note(entry.node, t_map_lidar));
        self.ready.push_back(Ok(Event::Scan(Scan { node: entry.node, time: entry.time, t_map_lidar, cloud })));
        let edges = self.nodes.as_ref().map(|(_, edges)| edges);
        // Scans of further sensors hang on the chain of the first: a chain through all of them would be longer than what was travelled.
        let before = [Some(0), self.latest].into_iter().flatten().find_map(|sensor| self.sensors.get(&sensor)?.previous.as_ref());
        if let Some(previous) = before {
            let odometry = match edges {
                Some(edges) => edges.odometry(previous, &entry),
                None => {
                    let t_from_to = previous.t_map_lidar.inv_mul(&entry.t_map_lidar);
                    vec![Edge { from: previous.node, to: entry.node, t_from_to, information: None }]
                }
            };
            self.ready.extend(odometry.into_iter().map(|e| Ok(Event::OdometryEdge(e))));
        }
        // Only a graph is asked for what was delivered: without one, it would be a list that grows with each scan for nothing.
        if edges.is_some() {
            self.delivered.insert(entry.node);
        }
        let loops = edges.map_or(&[][..], |edges| &edges.loops);
        for edge in self.loops_at.get(&entry.node).into_iter().flatten().filter_map(|k| loops.get(*k)) {
            if self.delivered.contains(&edge.from) && self.delivered.contains(&edge.to) {
                self.ready.push_back(Ok(Event::LoopEdge(edge.clone())));
            }
        }
        self.latest = Some(sensor);
        self.trail(sensor).previous = Some(entry);
    }

    /// Pose of the next scan of a sensor: as reported, or with the last correction carried over.
    fn continued(&mut self, sensor: u16, reported: &Pose) -> Pose {
        let trail = self.trail(sensor);
        let Some(previous) = trail.previous.as_ref().map(|previous| previous.t_map_lidar) else {
            return if self.latest.is_none() { *reported } else { self.continuation.pose(reported, reported, None) };
        };
        // Without a measurement, the previous step is the best estimate of the motion.
        let step = trail.step.replace(previous.inv_mul(reported));
        self.continuation.pose(reported, &previous, step.as_ref())
    }

    /// Queues the corrections that became known before `time`.
    fn queue_corrections(&mut self, time: f64) {
        while let Some(path) = self.corrections.take_due(time) {
            let correction = self.corrections.read(&path, &self.pose_change, self.tolerance_s);
            if let Ok(Correction { reported, corrected, .. }) = &correction {
                self.continuation.corrected(reported, corrected);
            }
            self.ready.push_back(correction.map(|c| Event::PoseUpdate(c.poses)));
        }
    }

    /// Queues a correction that came as a message.
    fn correct(&mut self, track: &PoseTrack) {
        if let Some(Correction { poses, reported, corrected }) = self.corrections.find_in(&track.changed(&self.pose_change), self.tolerance_s) {
            self.continuation.corrected(&reported, &corrected);
            self.robot.iter_mut().for_each(|robot| robot.correct(&poses));
            self.ready.push_back(Ok(Event::PoseUpdate(poses)));
        }
    }

    /// One step: an event that is ready, else a scan is processed or a message read.
    pub(crate) fn poll(&mut self) -> Polled<Result<Event>> {
        if self.ready.is_empty() {
            if self.selection.is_done(&self.selected) {
                return Polled::End;
            } else if self.is_first_due() {
                self.process_first();
            } else if self.ended {
                self.queue_corrections(f64::INFINITY);
                self.report_without_pose();
                return self.ready.pop_front().map_or(Polled::End, Polled::Item);
            } else {
                self.read_message();
            }
        }
        self.ready.pop_front().map_or(Polled::Nothing, Polled::Item)
    }

    /// Queues, at the end, the error about clouds without a pose.
    fn report_without_pose(&mut self) {
        let (count, first) = std::mem::take(&mut self.without_pose);
        if count > 0 {
            let problem = format!("{count} of {} clouds have no pose, the first at {first:.3} s", self.clouds);
            let (problem, remedy) = match self.reason.take() {
                Some(reason) => (
                    format!("{problem}: {reason}"),
                    "give the missing transform with --t-base-lidar and a topic of poses (--pose-topic), or other poses with --poses",
                ),
                None => {
                    let span = self.poses.span().map_or(String::new(), |[first, last]| format!("; poses are there from {first:.3} to {last:.3} s"));
                    (problem + &span, "they lie before, after or between the poses: choose others with --pose-topic or --poses")
                }
            };
            self.ready.push_back(Err(Error::dataset(&self.path, problem, remedy)));
        }
    }
}

impl Iterator for Player {
    type Item = Result<Event>;

    fn next(&mut self) -> Option<Result<Event>> {
        loop {
            match self.poll() {
                Polled::Item(event) => return Some(event),
                Polled::Nothing => {}
                Polled::End => return None,
            }
        }
    }
}
