//! The log of a run: what each scan took, what the map then was, which loops closed. `map` stores it beside the map for later reports.

use crate::usage;
use std::time::Duration;
use voxelastic::Pose;
use voxelastic::atlas::Atlas;
use voxelastic::event::{Event, NodeId};
use voxelastic::mapper::{Mapper, ScanReport};
use voxelastic_report::{Correction, FORMAT, LoopEdge, RunLog};

/// Writes a [`RunLog`].
#[derive(Debug)]
pub struct Recorder {
    log: RunLog,
    /// What the next correction took to find.
    optimise: Option<Duration>,
}

impl Default for Recorder {
    fn default() -> Self {
        let generator = concat!("voxelastic ", env!("CARGO_PKG_VERSION")).to_owned();
        Self { log: RunLog { format: FORMAT, generator, ..RunLog::default() }, optimise: None }
    }
}

/// What is remembered of an event that the mapper takes away, and of the mapper before it.
pub enum Seen {
    /// A scan: when and where.
    Scan { time: f64, t_map_lidar: Pose },
    /// A loop edge.
    Loop { from: NodeId, to: NodeId, before: Elastic },
    /// Corrected poses.
    Correction { before: Elastic },
    /// Something that is not logged.
    Other,
}

/// Counts of the elastic part.
pub struct Elastic {
    open_loops: usize,
    moves: usize,
    /// Done, under way and waiting.
    fusions: usize,
}

impl Elastic {
    fn of(mapper: &Mapper) -> Self {
        let counts = mapper.elastic_counts();
        Self { open_loops: mapper.graph_counts().open_loops, moves: counts.submap_moves, fusions: counts.fusions + counts.fusions_due }
    }
}

/// What the mapper made of an event.
pub struct Outcome<'a> {
    /// Of a scan.
    pub report: Option<&'a ScanReport>,
    /// From giving it to the mapper until it was done.
    pub wall: Duration,
    /// Processor time, where it is known.
    pub cpu: Option<Duration>,
}

impl Recorder {
    /// Remembers of `event` what [`note`](Self::note) needs. To be called before the mapper gets it.
    pub fn look(event: &Event, mapper: &Mapper) -> Seen {
        match event {
            Event::Scan(scan) => Seen::Scan { time: scan.time, t_map_lidar: scan.t_map_lidar },
            Event::LoopEdge(edge) => Seen::Loop { from: edge.from, to: edge.to, before: Elastic::of(mapper) },
            Event::PoseUpdate(_) => Seen::Correction { before: Elastic::of(mapper) },
            Event::OdometryEdge(_) => Seen::Other,
        }
    }

    /// Notes that the next correction took this long to be found.
    #[cfg_attr(not(feature = "optimize"), allow(dead_code))]
    pub fn optimised(&mut self, took: Duration) {
        self.optimise = Some(took);
    }

    /// Notes an event that the mapper took.
    pub fn note(&mut self, seen: &Seen, outcome: &Outcome<'_>, mapper: &Mapper) {
        let (after, wall_ms) = (self.log.scans.node.len(), milliseconds(outcome.wall));
        match (seen, outcome.report) {
            (Seen::Scan { time, t_map_lidar }, Some(report)) => {
                self.scan(*time, t_map_lidar, report, mapper.atlas());
                self.log.scans.fusions_due.push(mapper.elastic_counts().fusions_due as u32);
                self.log.scans.wall_ms.push(wall_ms);
                self.log.scans.cpu_ms.extend(outcome.cpu.map(milliseconds));
                self.phases(report);
            }
            (Seen::Loop { from, to, before }, _) => {
                let fusions = Elastic::of(mapper).fusions - before.fusions;
                self.log.loops.push(LoopEdge { from: *from, to: *to, after, wall_ms, fusions });
            }
            (Seen::Correction { before }, _) => {
                let now = Elastic::of(mapper);
                let optimise_ms = self.optimise.take().map(milliseconds);
                let (moved, closed) = (now.moves - before.moves, before.open_loops.saturating_sub(now.open_loops));
                let fusions = now.fusions - before.fusions;
                self.log.corrections.push(Correction { after, wall_ms, optimise_ms, moved, closed, fusions });
            }
            (Seen::Scan { .. } | Seen::Other, _) => {}
        }
    }

    /// The log so far.
    pub fn log(&self) -> &RunLog {
        &self.log
    }

    fn scan(&mut self, time: f64, t_map_lidar: &Pose, report: &ScanReport, atlas: &Atlas) {
        let scans = &mut self.log.scans;
        scans.node.push(report.node);
        scans.time_s.push(time);
        scans.position.push(<[f64; 3]>::from(t_map_lidar.translation.vector).map(rounded));
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

/// To three decimals: a log is read by people too.
fn rounded(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}
