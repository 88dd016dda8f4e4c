//! A mapper with its threads and the log of what it did.

use crate::log::{ColumnFile, EventSummary, Outcome, Recorder, StoredLog};
use crate::usage::{self, PoolClock};
use crate::warning::{Code, Warnings};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use voxelastic::atlas::{Atlas, SubmapId};
use voxelastic::event::Event;
use voxelastic::mapper::{IdleTask, MapError, Mapper, RebuildError, RebuildReport, Rebuilding, ScanReport, ScanSource};
use voxelastic::sensor::BeamModel;
use voxelastic::settings::Settings;
use voxelastic_eval::SeriesStats;
use voxelastic_report::RunLog;

/// A mapper, its thread pool, and the log of the run.
pub struct Mapping {
    mapper: Mapper,
    pool: rayon::ThreadPool,
    clock: PoolClock,
    recorder: Recorder,
    /// Where the log is, if not in memory.
    log_folder: Option<PathBuf>,
    /// Points on things that move, map frame, if they are wanted.
    moving_points: Option<Vec<[f32; 3]>>,
}

/// Statistics of the time per scan, with preparation, without reading and decoding of files. Milliseconds.
#[derive(Clone, Debug, Serialize)]
pub struct TimeSummary {
    /// Wall time of `Mapper::handle`.
    pub integrate_ms: SeriesStats,
    /// Processor time of all threads of the pool; `null` where the system does not report it.
    pub integrate_cpu_ms: SeriesStats,
    /// Wall time by phase: `prepare` (range image, local planes) and the phases of each field.
    pub phases_ms: BTreeMap<String, SeriesStats>,
}

/// A mapper with an empty map, of a sensor with tables of beams of its own, if they are known.
pub(crate) fn empty_mapper(settings: &Settings, sensor: Option<BeamModel>) -> crate::Result<Mapper> {
    let mut mapper = Mapper::new(settings.clone())?;
    sensor.into_iter().for_each(|model| mapper.set_sensor_model(model));
    Ok(mapper)
}

impl Mapping {
    /// Of `mapper` in `pool`; with the log of an earlier process, if it goes on with its run.
    pub fn new(mapper: Mapper, pool: rayon::ThreadPool, log: Option<RunLog>) -> Self {
        let (clock, recorder) = (PoolClock::new(&pool), log.map_or_else(Recorder::default, Recorder::resumed));
        Self { mapper, pool, clock, recorder, log_folder: None, moving_points: None }
    }

    /// Keeps the points on things that move, from now on.
    pub fn keep_moving_points(&mut self) {
        self.moving_points = Some(Vec::new());
    }

    /// The points on things that moved, each where it was: map frame, metres; none if they are not kept.
    pub fn moving_points(&self) -> &[[f32; 3]] {
        self.moving_points.as_deref().unwrap_or_default()
    }

    /// Keeps the log of all but the last scans in a file in `folder`, for runs that go on for hours. Where the system refuses, it stays in memory.
    pub fn keep_log_in(&mut self, folder: &Path, warnings: &mut Warnings) {
        self.log_folder = Some(folder.to_owned());
        let recorder = std::mem::take(&mut self.recorder);
        self.begin_log(recorder, warnings);
    }

    fn begin_log(&mut self, recorder: Recorder, warnings: &mut Warnings) {
        self.recorder = recorder;
        match self.log_folder.as_deref().map(ColumnFile::new) {
            Some(Ok(file)) => self.recorder.keep_on_disk(file),
            Some(Err(problem)) => warnings.add(Code::NoLog, format!("the log of the run stays in memory, which grows by it: {problem}"), ""),
            None => {}
        }
    }

    /// Begins a new map with another mapper, or goes on in one with the log of the run that made it.
    pub fn restart(&mut self, mapper: Mapper, log: Option<RunLog>, warnings: &mut Warnings) {
        self.mapper = mapper;
        self.begin_log(log.map_or_else(Recorder::default, Recorder::resumed), warnings);
    }

    /// Sets work for threads that would be idle during a scan, if the pool has more than one.
    pub fn set_idle_task(&mut self, task: impl FnOnce() -> IdleTask) {
        if self.pool.current_num_threads() > 1 {
            self.mapper.set_idle_task(task());
        }
    }

    /// Passes an event to the mapper and logs it. Returns a report for a scan.
    ///
    /// # Errors
    /// Those of the mapper; the map is then unchanged.
    pub fn take(&mut self, event: Event) -> Result<Option<ScanReport>, MapError> {
        let summary = EventSummary::of(&event, &self.mapper);
        let before = self.clock.now();
        let clock = Instant::now();
        let mapper = &mut self.mapper;
        let done = self.pool.install(|| mapper.handle(event));
        let wall = clock.elapsed();
        if let Ok(report) = &done {
            if let Some(ScanReport { node, submap, counts, .. }) = report {
                tracing::debug!("scan {node} in submap {submap}: {} points, {:.1} ms", counts.usable, wall.as_secs_f64() * 1e3);
            }
            let cpu = before.zip(self.clock.now()).map(|(before, after)| after.saturating_sub(before));
            if let (Some(points), Some(_)) = (&mut self.moving_points, report) {
                points.extend_from_slice(self.mapper.moving_points());
            }
            self.recorder.moving(&summary, report.as_ref(), self.mapper.moving_points());
            self.recorder.record(&summary, &Outcome { report: report.as_ref(), wall, cpu }, &self.mapper);
        }
        done
    }

    /// Logs the time of the optimisation that the next correction is the result of.
    pub fn optimised(&mut self, took: Duration) {
        self.recorder.optimised(took);
    }

    /// Completes the fusions that have begun or are due.
    pub fn finish_fusions(&mut self) {
        let mapper = &mut self.mapper;
        self.pool.install(|| mapper.finish_fusions());
    }

    /// Finishes the map: completes fusions and resolves conflicts between submaps.
    pub fn finish(&mut self) {
        let mapper = &mut self.mapper;
        self.pool.install(|| mapper.finish());
    }

    /// Rebuilds a submap from its scans.
    ///
    /// # Errors
    /// When a scan cannot be read again; the submap is then unchanged.
    pub fn rebuild(&mut self, id: SubmapId, source: &mut (dyn ScanSource + Send)) -> Result<RebuildReport, RebuildError> {
        let mapper = &mut self.mapper;
        self.pool.install(|| mapper.rebuild(id, source))
    }

    /// Integrates the next scan into a submap that is being rebuilt; a report once it is in its place.
    ///
    /// # Errors
    /// When a scan cannot be read again, or the submap is gone; the map is then unchanged.
    pub fn step_rebuild(&mut self, rebuilding: &mut Rebuilding, source: &mut (dyn ScanSource + Send)) -> Result<Option<RebuildReport>, RebuildError> {
        let mapper = &mut self.mapper;
        self.pool.install(|| mapper.step_rebuild(rebuilding, source))
    }

    /// The mapper.
    pub fn mapper(&self) -> &Mapper {
        &self.mapper
    }

    /// The map.
    pub fn atlas(&self) -> &Atlas {
        self.mapper.atlas()
    }

    /// The map, without its threads and its log; it is completed first.
    pub fn into_atlas(self) -> Atlas {
        let Self { mapper, pool, .. } = self;
        pool.install(|| mapper.into_atlas())
    }

    /// Sets the sensor's own tables of beams before the first scan.
    pub(crate) fn set_sensor_model(&mut self, model: BeamModel) {
        self.mapper.set_sensor_model(model);
    }

    /// Number of threads.
    pub fn threads(&self) -> usize {
        self.pool.current_num_threads()
    }

    /// The thread pool.
    pub fn pool(&self) -> &rayon::ThreadPool {
        &self.pool
    }

    /// Number of scans integrated so far.
    pub fn scans(&self) -> usize {
        self.recorder.scans()
    }

    /// Statistics of the time per scan so far.
    pub fn times(&self) -> TimeSummary {
        let log = self.recorder.log();
        TimeSummary {
            integrate_ms: SeriesStats::new(&log.scans.wall_ms),
            integrate_cpu_ms: SeriesStats::new(&log.scans.cpu_ms),
            phases_ms: log.phases_ms.iter().map(|(name, times)| (name.clone(), SeriesStats::new(times))).collect(),
        }
    }

    /// The log of the run so far, without totals, to be stored: of a run that goes on.
    pub fn stored_log(&self) -> StoredLog<'_> {
        self.recorder.stored()
    }

    /// The log of the run so far. The caller adds the totals of the command.
    pub fn log(&self) -> RunLog {
        let counts = self.mapper.elastic_counts();
        RunLog {
            threads: self.threads(),
            fusions: counts.fusions,
            groups_apart: counts.size_limited_groups,
            submap_moves: counts.submap_moves,
            peak_rss_mb: usage::peak_resident_bytes().map(usage::megabytes),
            ..self.recorder.log()
        }
    }
}
