//! The log of a run: times of scans, size of the map after each, loop closures. `map` stores it in the map directory for reports.

mod columns;

pub use columns::ColumnFile;
use columns::{Columns, FirstColumns};

use crate::error::one_line;
use crate::joining::numbers;
use crate::usage;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::time::Duration;
use voxelastic::Pose;
use voxelastic::atlas::Atlas;
use voxelastic::event::{Event, NodeId};
use voxelastic::geometry::Rigid;
use voxelastic::mapper::{Mapper, ScanReport};
use voxelastic_report::{Correction, FORMAT, LoopEdge, RunLog, ScanLog};

/// Writes a [`RunLog`].
#[derive(Debug)]
pub struct Recorder {
    /// Without the columns that are on the disk.
    log: RunLog,
    on_disk: Option<ColumnFile>,
    /// Time of the optimisation that the next correction is the result of.
    optimise: Option<Duration>,
}

impl Default for Recorder {
    fn default() -> Self {
        let generator = concat!("voxelastic ", env!("CARGO_PKG_VERSION")).to_owned();
        Self { log: RunLog { format: FORMAT, generator, ..RunLog::default() }, on_disk: None, optimise: None }
    }
}

/// A log as a checkpoint has it.
#[derive(Debug, Serialize, Deserialize)]
pub struct StoredLog<'a> {
    first: FirstColumns<'a>,
    /// The columns of the last scans, and what is no column.
    last: Cow<'a, RunLog>,
}

impl StoredLog<'_> {
    /// The log in one piece, of one that was read.
    pub fn whole(self) -> RunLog {
        let last = self.last.into_owned();
        let FirstColumns::Stored(columns) = self.first else { return last };
        let mut whole = RunLog { scans: ScanLog::default(), phases_ms: BTreeMap::new(), ..last.clone() };
        columns.into_iter().for_each(|columns| columns.append_to(&mut whole));
        Columns::all_of(&last).append_to(&mut whole);
        whole
    }
}

/// What is logged of an event, taken before the mapper consumes it.
pub enum EventSummary {
    /// A scan.
    Scan { time: f64, t_map_lidar: Pose },
    /// A loop edge.
    Loop { edge: Box<LoopEdge>, before: ElasticState },
    /// Corrected poses.
    Correction { newest: Option<(NodeId, [f64; 7])>, before: ElasticState },
    /// An event that is not logged.
    Other,
}

/// Counts of loops, moves and fusions in the mapper.
pub struct ElasticState {
    open_loops: usize,
    moves: usize,
    /// Completed, running and due.
    fusions: usize,
}

impl ElasticState {
    fn of(mapper: &Mapper) -> Self {
        let counts = mapper.elastic_counts();
        Self { open_loops: mapper.graph_counts().open_loops, moves: counts.submap_moves, fusions: counts.fusions + counts.fusions_due }
    }
}

/// Result of an event.
pub struct Outcome<'a> {
    /// The report on a scan.
    pub report: Option<&'a ScanReport>,
    /// Wall time of `Mapper::handle`.
    pub wall: Duration,
    /// Processor time, where it is known.
    pub cpu: Option<Duration>,
}

impl EventSummary {
    /// Of an event, and of the mapper before it.
    pub fn of(event: &Event, mapper: &Mapper) -> Self {
        match event {
            Event::Scan(scan) => Self::Scan { time: scan.time, t_map_lidar: scan.t_map_lidar },
            Event::LoopEdge(edge) => {
                let measured = LoopEdge {
                    from: edge.from,
                    to: edge.to,
                    measured: Some(numbers(&edge.t_from_to)),
                    information: edge.information,
                    ..LoopEdge::default()
                };
                Self::Loop { edge: Box::new(measured), before: ElasticState::of(mapper) }
            }
            Event::PoseUpdate(poses) => {
                let newest = poses.iter().max_by_key(|(node, _)| *node).map(|(node, pose)| (*node, numbers(pose)));
                Self::Correction { newest, before: ElasticState::of(mapper) }
            }
            _ => Self::Other,
        }
    }
}

impl Recorder {
    /// One that adds to a log.
    pub fn resumed(log: RunLog) -> Self {
        Self { log, on_disk: None, optimise: None }
    }

    /// Keeps the columns of all but the last scans in `file`, which is empty.
    pub fn keep_on_disk(&mut self, file: ColumnFile) {
        self.on_disk = Some(file);
        self.spill();
    }

    /// Moves columns to the disk, if there are enough of them. Where the disk refuses, they stay in memory, as do those that follow.
    fn spill(&mut self) {
        let Some(file) = &mut self.on_disk else { return };
        if let Err(problem) = file.move_from(&mut self.log) {
            tracing::warn!("the log of the run stays in memory, which grows by it: {problem}");
            let whole = self.log();
            (self.log, self.on_disk) = (whole, None);
        }
    }

    /// Logs the time of the optimisation that the next correction is the result of.
    pub fn optimised(&mut self, took: Duration) {
        self.optimise = Some(took);
    }

    /// Logs an event that the mapper has handled.
    pub fn record(&mut self, summary: &EventSummary, outcome: &Outcome<'_>, mapper: &Mapper) {
        let (after, wall_ms) = (self.scans(), milliseconds(outcome.wall));
        match (summary, outcome.report) {
            (EventSummary::Scan { time, t_map_lidar }, Some(report)) => {
                self.scan(*time, t_map_lidar, report, mapper.atlas());
                self.log.scans.fusions_due.push(mapper.elastic_counts().fusions_due as u32);
                self.log.scans.wall_ms.push(wall_ms);
                self.log.scans.cpu_ms.extend(outcome.cpu.map(milliseconds));
                self.phases(report);
                self.spill();
            }
            (EventSummary::Loop { edge, before }, _) => {
                let fusions = ElasticState::of(mapper).fusions - before.fusions;
                self.log.loops.push(LoopEdge { after, wall_ms, fusions, ..**edge });
            }
            (EventSummary::Correction { newest, before }, _) => {
                let now = ElasticState::of(mapper);
                let optimise_ms = self.optimise.take().map(milliseconds);
                let (moved, closed) = (now.moves - before.moves, before.open_loops.saturating_sub(now.open_loops));
                let fusions = now.fusions - before.fusions;
                self.log.corrections.push(Correction { after, wall_ms, optimise_ms, moved, closed, fusions, newest: *newest });
            }
            (EventSummary::Scan { .. } | EventSummary::Other, _) => {}
        }
    }

    /// Logs the points of a scan that are on something that moves: map frame, metres.
    pub fn moving(&mut self, summary: &EventSummary, report: Option<&ScanReport>, points: &[[f32; 3]]) {
        if let (EventSummary::Scan { t_map_lidar, .. }, Some(report)) = (summary, report) {
            let t_lidar_map = Rigid::from(&t_map_lidar.inverse());
            self.log.moving.push(report.node, points.iter().map(|p| t_lidar_map.apply(*p)));
        }
    }

    /// The log so far.
    pub fn log(&self) -> RunLog {
        let Some(file) = &self.on_disk else { return self.log.clone() };
        let mut whole = RunLog { scans: ScanLog::default(), phases_ms: BTreeMap::new(), ..self.log.clone() };
        let read = file.pieces().try_for_each(|columns| columns.map(|columns| columns.append_to(&mut whole)));
        if let Err(problem) = read {
            tracing::warn!("the log of the run lacks scans: {}", one_line(&problem));
        }
        Columns::all_of(&self.log).append_to(&mut whole);
        whole
    }

    /// Number of scans in it.
    pub fn scans(&self) -> usize {
        self.on_disk.as_ref().map_or(0, ColumnFile::scans) + self.log.scans.node.len()
    }

    /// The log so far, to be stored.
    pub fn stored(&self) -> StoredLog<'_> {
        StoredLog { first: FirstColumns::OnDisk(self.on_disk.as_ref()), last: Cow::Borrowed(&self.log) }
    }

    fn scan(&mut self, time: f64, t_map_lidar: &Pose, report: &ScanReport, atlas: &Atlas) {
        let scans = &mut self.log.scans;
        scans.node.push(report.node);
        scans.time_s.push(time);
        scans.position.push(<[f64; 3]>::from(t_map_lidar.translation.vector).map(|c| (c * 1e5).round() / 1e5));
        scans.orientation.push(<[f64; 4]>::from(t_map_lidar.rotation.coords).map(|c| (c * 1e7).round() / 1e7));
        scans.submap.push(report.submap);
        scans.submaps.push(atlas.submaps().len() as u32);
        scans.map_mb.push(rounded(usage::megabytes(atlas.bytes() as u64)));
        scans.rss_mb.extend(usage::resident_bytes().map(|b| rounded(usage::megabytes(b))));
    }

    fn phases(&mut self, report: &ScanReport) {
        let mut phase = |name: &str, time: Duration| self.log.phases_ms.entry(name.to_owned()).or_default().push(milliseconds(time));
        phase("prepare", report.prepare);
        phase("elastic", report.elastic);
        if let Some(tsdf) = &report.tsdf {
            phase("tsdf_transform", tsdf.phases.transform);
            phase("tsdf_select", tsdf.phases.select);
            phase("tsdf_allocate", tsdf.phases.allocate);
            phase("tsdf_update", tsdf.phases.update);
        }
        if let Some(occupancy) = &report.occupancy {
            phase("occupancy_see", occupancy.phases.see);
            phase("occupancy_descend", occupancy.phases.descend);
            phase("occupancy_select", occupancy.phases.select);
            phase("occupancy_allocate", occupancy.phases.allocate);
            phase("occupancy_update", occupancy.phases.update);
            phase("occupancy_propagate", occupancy.phases.propagate);
        }
    }
}

fn milliseconds(time: Duration) -> f64 {
    rounded(time.as_secs_f64() * 1e3)
}

/// Rounds to three decimals, to keep the log short.
fn rounded(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}
