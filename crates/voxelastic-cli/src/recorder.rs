//! The log of a run: what each scan took, what the map then was, which loops closed. `map` stores it beside the map for later reports.

use crate::usage;
use std::time::Duration;
use voxelastic::Pose;
use voxelastic::atlas::Atlas;
use voxelastic::event::Event;
use voxelastic::mapper::ScanReport;
use voxelastic_report::{Correction, FORMAT, LoopEdge, RunLog};

/// Writes a [`RunLog`].
#[derive(Debug)]
pub struct Recorder(RunLog);

impl Default for Recorder {
    fn default() -> Self {
        Self(RunLog { format: FORMAT, generator: concat!("voxelastic ", env!("CARGO_PKG_VERSION")).to_owned(), ..RunLog::default() })
    }
}

/// What is remembered of an event that the mapper takes away.
pub enum Seen {
    /// A scan: when and where.
    Scan { time: f64, t_map_lidar: Pose },
    /// A loop edge.
    Loop(LoopEdge),
    /// Corrected poses.
    Correction,
    /// Something that is not logged.
    Other,
}

impl Recorder {
    /// Remembers of `event` what [`note`](Self::note) needs.
    pub fn look(event: &Event) -> Seen {
        match event {
            Event::Scan(scan) => Seen::Scan { time: scan.time, t_map_lidar: scan.t_map_lidar },
            Event::LoopEdge(edge) => Seen::Loop(LoopEdge { from: edge.from, to: edge.to }),
            Event::PoseUpdate(_) => Seen::Correction,
            Event::OdometryEdge(_) => Seen::Other,
        }
    }

    /// Notes an event that the mapper took.
    pub fn note(&mut self, seen: &Seen, report: Option<&ScanReport>, wall: Duration, cpu: Option<Duration>, atlas: &Atlas) {
        match (seen, report) {
            (Seen::Scan { time, t_map_lidar }, Some(report)) => {
                self.scan(*time, t_map_lidar, report, atlas);
                self.0.scans.wall_ms.push(milliseconds(wall));
                self.0.scans.cpu_ms.extend(cpu.map(milliseconds));
                self.phases(report);
            }
            (Seen::Loop(edge), _) => self.0.loops.push(*edge),
            (Seen::Correction, _) => self.0.corrections.push(Correction { after: self.0.scans.node.len(), wall_ms: milliseconds(wall) }),
            (Seen::Scan { .. } | Seen::Other, _) => {}
        }
    }

    /// The log so far.
    pub fn log(&self) -> &RunLog {
        &self.0
    }

    fn scan(&mut self, time: f64, t_map_lidar: &Pose, report: &ScanReport, atlas: &Atlas) {
        let scans = &mut self.0.scans;
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
        let mut phase = |name: &str, time: Duration| self.0.phases_ms.entry(name.to_owned()).or_default().push(milliseconds(time));
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
