//! What the odometry did, scan by scan, and the figures that follow.

use crate::warning::{Code, Warnings};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Duration;
use voxelastic::event::NodeId;
use voxelastic::geometry::PoseExt;
use voxelastic::geometry::stored::StoredPose;
use voxelastic_eval::SeriesStats;
use voxelastic_report::RegistrationLog;
use voxelastic_slam::odometry::{Level, OdometryReport, Status};

/// Outcomes of all registrations.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct OdometryLog {
    scans: usize,
    failed: BTreeMap<String, usize>,
    degenerate: usize,
    pieces: usize,
    gaps: usize,
    alternates: bool,
    level: Level,
    /// Scans until a degenerate one is a new stretch.
    degenerate_before: usize,
    path_m: f64,
    drift: Option<OdometryDrift>,
    /// Pose and piece of the last scan that was registered.
    last: Option<(StoredPose, usize)>,
    cpu_ms: Vec<f64>,
    prepare_ms: Vec<f64>,
    register_ms: Vec<f64>,
    update_ms: Vec<f64>,
    overlap: Vec<f64>,
    spread_m: Vec<f64>,
    iterations: Vec<f64>,
    registrations: RegistrationLog,
}

/// How wrong the last pose can have become since the first of its piece, without closures: standard deviations, as the odometry estimates them.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct OdometryDrift {
    /// Of the position, metres: the root of the sum of the three variances.
    pub position_m: f64,
    /// Of the largest component of the rotation, degrees.
    pub rotation_deg: f64,
}

impl OdometryDrift {
    fn of(report: &OdometryReport) -> Self {
        let variance = |k: usize| report.covariance[(k, k)];
        Self { position_m: (0..3).map(variance).sum::<f64>().sqrt(), rotation_deg: (3..6).map(variance).fold(0.0, f64::max).sqrt().to_degrees() }
    }
}

/// Figures of the odometry, as JSON has them.
#[derive(Clone, Debug, Serialize)]
pub struct OdometrySummary {
    /// Scans that were to be registered.
    pub registered_of: usize,
    /// Scans whose pose is a prediction only, by reason.
    pub failed: BTreeMap<String, usize>,
    /// Scans whose surfaces did not hold the pose along some directions.
    pub degenerate: usize,
    /// Pieces of the trajectory; no odometry leads from one to the next.
    pub pieces: usize,
    /// Gaps in the times of the scans: more than a second, and several times as long as usual.
    pub gaps: usize,
    /// Whether the scans are those of two sensors by turns.
    pub alternates: bool,
    /// How the map frame is levelled: `gravity`, `surfaces` or `unknown`.
    pub level: &'static str,
    /// Length of the trajectory, metres.
    pub path_m: f64,
    /// How wrong the last pose can be; `null` if no scan was registered to another.
    pub drift: Option<OdometryDrift>,
    /// Processor time of a scan, without reading and decoding, milliseconds; `null` where the system does not report it.
    pub cpu_ms: SeriesStats,
    /// Wall time of a scan by phase (`prepare`, `register`, `update`), milliseconds.
    pub phases_ms: BTreeMap<&'static str, SeriesStats>,
    /// Share of a scan's surfaces that have a counterpart in the local map.
    pub overlap: SeriesStats,
    /// Robust mean distance to the surfaces of the local map, metres.
    pub spread_m: SeriesStats,
    /// Iterations of a registration.
    pub iterations: SeriesStats,
    /// Scan by scan, for the report.
    #[serde(skip)]
    pub registrations: RegistrationLog,
}

impl OdometryLog {
    /// Adds the outcome for the scan of a node, and what is to be warned of; `cpu` is its processor time, where it is known. Returns what is to be said about it, if it was not
    /// registered as usual.
    pub fn add(&mut self, node: NodeId, report: &OdometryReport, cpu: Option<Duration>, warnings: &mut Warnings) -> Option<String> {
        let said = self.count(report, cpu, warnings);
        let degenerate = matches!(report.status, Status::Degenerate { .. }).then(|| "held in some directions only".to_owned());
        let r = &mut self.registrations;
        r.node.push(node);
        r.score.push(rounded(if report.status == Status::First { 1.0 } else { report.score }));
        r.overlap.push(rounded(report.overlap));
        r.sigma_m.push(rounded(OdometryDrift::of(report).position_m));
        r.remark.push(said.clone().or(degenerate).unwrap_or_default());
        said
    }

    fn count(&mut self, report: &OdometryReport, cpu: Option<Duration>, warnings: &mut Warnings) -> Option<String> {
        self.scans += 1;
        self.pieces = report.piece + 1;
        self.level = report.level;
        if let Some(gap) = report.gap {
            self.gaps += 1;
            warnings.add(Code::Gap, format!("{gap:.1} s without scans: the sensor may have moved meanwhile"), "");
        }
        if report.alternates && !self.alternates {
            self.alternates = true;
            let text = "every second scan comes from another place: are the scans of two sensors in one stream?";
            warnings.add(Code::Alternates, text, "name one of them (--cloud-topic)");
        }
        let degenerate = matches!(report.status, Status::Degenerate { .. });
        if degenerate && self.degenerate_before == 0 {
            let text = "the surfaces around the sensor do not hold its pose in all directions, as in a tunnel: in those, it is a prediction";
            warnings.add(Code::Degenerate, text, "");
        }
        // Said once for each stretch of such scans.
        self.degenerate_before = if degenerate { 20 } else { self.degenerate_before.saturating_sub(1) };
        self.cpu_ms.extend(cpu.map(milliseconds));
        let pose = StoredPose(report.t_map_lidar);
        match report.status {
            Status::Failed(failure) => {
                *self.failed.entry(failure.to_string()).or_default() += 1;
                return Some(format!("not registered: {failure}"));
            }
            Status::First => self.last = Some((pose, report.piece)),
            _ => {
                if let Some((last, _)) = self.last.replace((pose, report.piece)).filter(|(_, piece)| *piece == report.piece) {
                    self.path_m += last.0.translation_distance(&pose.0);
                }
                self.drift = Some(OdometryDrift::of(report));
                self.degenerate += usize::from(matches!(report.status, Status::Degenerate { .. }));
                self.prepare_ms.push(milliseconds(report.times.prepare));
                self.register_ms.push(milliseconds(report.times.register));
                self.update_ms.push(milliseconds(report.times.update));
                self.overlap.push(report.overlap);
                self.spread_m.push(report.spread);
                self.iterations.push(report.iterations as f64);
            }
        }
        let begins = report.status == Status::First && report.piece > 0;
        begins.then(|| format!("no scan fitted for a while: piece {} of the trajectory begins", self.pieces))
    }

    /// Scans that were registered.
    pub fn registered(&self) -> usize {
        self.scans - self.failed.values().sum::<usize>()
    }

    /// The figures so far.
    pub fn summary(&self) -> OdometrySummary {
        let phases = [("prepare", &self.prepare_ms), ("register", &self.register_ms), ("update", &self.update_ms)];
        OdometrySummary {
            registered_of: self.scans,
            failed: self.failed.clone(),
            degenerate: self.degenerate,
            pieces: self.pieces,
            gaps: self.gaps,
            alternates: self.alternates,
            level: level_key(self.level),
            path_m: self.path_m,
            drift: self.drift,
            cpu_ms: SeriesStats::new(&self.cpu_ms),
            phases_ms: phases.into_iter().map(|(name, times)| (name, SeriesStats::new(times))).collect(),
            overlap: SeriesStats::new(&self.overlap),
            spread_m: SeriesStats::new(&self.spread_m),
            iterations: SeriesStats::new(&self.iterations),
            registrations: self.registrations.clone(),
        }
    }
}

impl OdometrySummary {
    /// Logs the figures in two lines; `threads` is the size of the pool.
    pub fn log(&self, threads: usize) {
        let failed: usize = self.failed.values().sum();
        let failures = if failed > 0 { format!(", {failed} scans not registered") } else { String::new() };
        let pieces = if self.pieces > 1 { format!(", in {} pieces", self.pieces) } else { String::new() };
        let drift = self.drift.map_or(String::new(), |d| {
            format!(", about {:.2} m and {:.2} degrees (one sigma) off at the end, without closures", d.position_m, d.rotation_deg)
        });
        tracing::info!("odometry: {} scans, {:.1} m{drift}{pieces}{failures}", self.registered_of, self.path_m);
        tracing::info!(
            "map frame: {}",
            match self.level {
                "gravity" => "level, by the inertial unit",
                "surfaces" => "level, by the ground and walls of the first scan (a sensor about upright is assumed)",
                _ => "tilted as the first scan was: neither an inertial unit at rest nor ground and walls told which way is up",
            }
        );
        if let (Some(median), Some(p95)) = (self.cpu_ms.median, self.cpu_ms.p95) {
            tracing::info!("odometry: median {median:.1} ms, 95 % within {p95:.1} ms of processor time a scan, {threads} threads");
        }
    }
}

fn level_key(level: Level) -> &'static str {
    match level {
        Level::Gravity => "gravity",
        Level::Surfaces => "surfaces",
        _ => "unknown",
    }
}

/// Three decimals are enough for a picture.
fn rounded(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}

fn milliseconds(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}
