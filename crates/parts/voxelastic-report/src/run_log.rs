//! The log of the run that made a map, stored with it as JSON, so that a report can be made later.
//!
//! Keys may be added to the format: readers use defaults for missing keys and ignore unknown ones. Any other change increments [`FORMAT`], which older
//! programs reject.

use crate::error::{ReportError, Result};
use crate::moving_log::MovingLog;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Version of the log that this program writes, and the newest that it reads.
pub const FORMAT: u32 = 1;

/// A run of the mapper. Lengths in metres, times in milliseconds unless stated otherwise.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct RunLog {
    /// The [`FORMAT`] it was written in.
    pub format: u32,
    /// Program and version.
    pub generator: String,
    /// The data, as they were named.
    pub input: String,
    /// Threads of the mapper.
    pub threads: usize,
    /// From start to saved map, seconds.
    pub total_s: f64,
    /// Whether the run was interrupted.
    pub interrupted: bool,
    /// Scans that could not be used.
    pub scans_skipped: usize,
    /// Submaps fused into others.
    pub fusions: usize,
    /// Groups of submaps joined by closed loops whose merge was rejected, because the result would be too large.
    pub groups_apart: usize,
    /// Root poses moved by corrections.
    pub submap_moves: usize,
    /// Peak memory of the process, megabytes (10^6 bytes).
    pub peak_rss_mb: Option<f64>,
    /// One value per scan in each column, in the order of integration.
    pub scans: ScanLog,
    /// Wall time of each scan by phase; one value per scan.
    pub phases_ms: BTreeMap<String, Vec<f64>>,
    /// Loop edges, in order of arrival.
    pub loops: Vec<LoopEdge>,
    /// Pose corrections, in order of arrival.
    pub corrections: Vec<Correction>,
    /// Registrations of the odometry; empty where the data had poses.
    pub registrations: RegistrationLog,
    /// Loop closures that were looked for and tried, in order.
    pub closures: Vec<TriedClosure>,
    /// Points on things that moved, which were set aside.
    pub moving: MovingLog,
    /// What the run had to say that is no error.
    pub warnings: Vec<Warning>,
}

/// Something that a run has to say that is no error.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Warning {
    /// What it is about: a stable name, such as `scan-skipped`.
    pub code: String,
    /// What happened, the first time.
    pub text: String,
    /// What helps; empty if nothing is known.
    pub remedy: String,
    /// How often it happened.
    pub count: usize,
}

/// Registrations of raw scans, also of those that were not mapped: columns with a value per scan.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct RegistrationLog {
    /// Node that the scan has, or would have, in the map.
    pub node: Vec<u64>,
    /// How well it fits, 0 to 1; 0 if it was not registered.
    pub score: Vec<f64>,
    /// Share of its surfaces that have a counterpart in the local map, 0 to 1.
    pub overlap: Vec<f64>,
    /// How wrong its position can have become since the first scan of its piece, without closures: standard deviation, metres; 0 if it was not registered.
    pub sigma_m: Vec<f64>,
    /// What is to be said about it, in words; empty if nothing.
    pub remark: Vec<String>,
}

/// A loop closure that was tried.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct TriedClosure {
    /// A node of the earlier place.
    pub from: u64,
    /// A node of the later place.
    pub to: u64,
    /// `accepted`, or why not: `free_space`, `poor_fit`, `not_registered`, `beyond_drift`.
    pub verdict: String,
    /// Correlation of the places seen from above, 0 to 1.
    pub correlation: f64,
    /// Share of the surfaces with a counterpart.
    pub overlap: Option<f64>,
    /// How well they lie on each other, 0 to 1.
    pub score: Option<f64>,
    /// Share of the surfaces in space that was observed to be free.
    pub contradiction: Option<f64>,
    /// Distance between the closure and the poses before it, metres.
    pub correction_m: f64,
}

/// Columns with a value per scan.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ScanLog {
    /// Node of the scan.
    pub node: Vec<u64>,
    /// Time of the scan, seconds of its own clock.
    pub time_s: Vec<f64>,
    /// Position when it was integrated, before any later correction: map frame.
    pub position: Vec<[f64; 3]>,
    /// Orientation likewise: quaternion x y z w of the lidar in the map frame.
    pub orientation: Vec<[f64; 4]>,
    /// Wall time of the integration.
    pub wall_ms: Vec<f64>,
    /// Processor time of all mapping threads; empty where the system does not report it.
    pub cpu_ms: Vec<f64>,
    /// Its submap when it was integrated.
    pub submap: Vec<u32>,
    /// Number of submaps after it.
    pub submaps: Vec<u32>,
    /// Fusions running or pending after it.
    pub fusions_due: Vec<u32>,
    /// Memory of the map's fields after it, megabytes.
    pub map_mb: Vec<f64>,
    /// Memory of the process after it, megabytes; empty where the system does not report it.
    pub rss_mb: Vec<f64>,
}

/// A loop edge and its immediate effects. If it contradicts the poses, it closes with a later [`Correction`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct LoopEdge {
    /// One node.
    pub from: u64,
    /// The other.
    pub to: u64,
    /// Scans integrated before it.
    pub after: usize,
    /// Time in the mapper.
    pub wall_ms: f64,
    /// Fusions of submaps that it requested; they run in the background of the following scans.
    pub fusions: usize,
    /// What it measured: pose of `to` in the frame of `from`, x y z qx qy qz qw; none in older logs.
    pub measured: Option<[f64; 7]>,
    /// Its information, upper triangle row by row (x y z roll pitch yaw); none where it came without.
    pub information: Option<[f64; 21]>,
}

/// A correction of poses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Correction {
    /// Scans integrated before it.
    pub after: usize,
    /// Time in the mapper.
    pub wall_ms: f64,
    /// Time in the optimiser; none if the poses are from another source.
    pub optimise_ms: Option<f64>,
    /// Number of moved submaps.
    pub moved: usize,
    /// Number of closed loops.
    pub closed: usize,
    /// Fusions of submaps that it requested; they run in the background of the following scans.
    pub fusions: usize,
    /// The newest scan that it moved, from whose pose the odometry went on: its node, and its pose in the map frame then, x y z qx qy qz qw.
    pub newest: Option<(u64, [f64; 7])>,
}

impl RunLog {
    /// The log as JSON, to be stored with a map.
    ///
    /// # Errors
    /// [`ReportError::Json`].
    pub fn to_json(&self) -> Result<String> {
        Ok(serde_json::to_string(self)?)
    }

    /// Reads what [`to_json`](Self::to_json) wrote, in this or an older version of the program. Columns that are not as long as that of the
    /// nodes are dropped.
    ///
    /// # Errors
    /// [`ReportError::RunLog`] for a newer format, and for what is no log.
    pub fn from_json(text: &str) -> Result<Self> {
        let mut log: Self = serde_json::from_str(text).map_err(|e| ReportError::RunLog(e.to_string()))?;
        if log.format == 0 || log.format > FORMAT {
            return Err(ReportError::RunLog(format!("it has format {}, and this program reads up to {FORMAT}", log.format)));
        }
        log.drop_misfits();
        Ok(log)
    }

    fn drop_misfits(&mut self) {
        fn fit<T>(column: &mut Vec<T>, scans: usize) {
            if column.len() != scans {
                column.clear();
            }
        }
        let scans = self.scans.node.len();
        let s = &mut self.scans;
        fit(&mut s.time_s, scans);
        fit(&mut s.position, scans);
        fit(&mut s.orientation, scans);
        [&mut s.wall_ms, &mut s.cpu_ms, &mut s.map_mb, &mut s.rss_mb].into_iter().for_each(|c| fit(c, scans));
        [&mut s.submap, &mut s.submaps, &mut s.fusions_due].into_iter().for_each(|c| fit(c, scans));
        self.phases_ms.retain(|_, column| column.len() == scans);
        let r = &mut self.registrations;
        let registered = r.node.len();
        [&mut r.score, &mut r.overlap, &mut r.sigma_m].into_iter().for_each(|column| column.resize(registered, 0.0));
        r.remark.resize(registered, String::new());
        if !self.moving.is_whole() {
            self.moving = MovingLog::default();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn log() -> RunLog {
        let scans = ScanLog { node: vec![3, 4], wall_ms: vec![1.5, 2.5], submaps: vec![1, 1], ..ScanLog::default() };
        let phases_ms = [("prepare".to_owned(), vec![0.5, 0.25])].into_iter().collect();
        RunLog {
            format: FORMAT,
            threads: 2,
            scans,
            phases_ms,
            loops: vec![LoopEdge { from: 3, to: 4, after: 2, ..LoopEdge::default() }],
            registrations: RegistrationLog {
                node: vec![3],
                score: vec![0.5],
                overlap: vec![0.75],
                sigma_m: vec![0.125],
                remark: vec![String::new()],
            },
            moving: MovingLog { total: 9, every: 4, node: vec![4], count: vec![2], position: vec![[0.5, 1.0, 0.25], [2.0, 0.0, 0.75]] },
            closures: vec![TriedClosure { from: 3, to: 4, verdict: "accepted".into(), overlap: Some(0.5), ..TriedClosure::default() }],
            ..RunLog::default()
        }
    }

    #[test]
    fn round_trip() {
        assert_eq!(RunLog::from_json(&log().to_json().unwrap()).unwrap(), log());
    }

    #[test]
    fn older_logs_are_read_with_defaults_and_newer_ones_are_rejected() {
        let old =
            RunLog::from_json(r#"{"format":1,"scans":{"node":[1,2],"wall_ms":[3,4],"rss_mb":[1]},"moving":{"total":1,"count":[1]},"later":true}"#)
                .unwrap();
        assert_eq!((old.scans.wall_ms.len(), old.scans.rss_mb.len(), old.threads, old.moving.total), (2, 0, 0, 0));
        let newer = RunLog::from_json(r#"{"format":2}"#).unwrap_err().to_string();
        assert!(newer.contains("format 2"), "{newer}");
        for nonsense in ["", "[]", "{}", "{\"format\":1,\"scans\":7}"] {
            assert!(RunLog::from_json(nonsense).is_err(), "{nonsense}");
        }
    }
}
