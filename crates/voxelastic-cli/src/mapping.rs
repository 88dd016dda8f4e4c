//! Mapping under way: events into the mapper, in a pool of threads of its own, with a log of how it went.

use crate::recorder::{Outcome, Recorder};
use crate::usage;
use serde::Serialize;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};
use voxelastic::atlas::SubmapId;
use voxelastic::event::Event;
use voxelastic::mapper::{Chore, MapError, Mapper, RebuildError, RebuildReport, ScanReport, ScanSource};
use voxelastic_eval::Spread;
use voxelastic_report::RunLog;

/// A mapper at work.
pub struct Session {
    mapper: Mapper,
    pool: rayon::ThreadPool,
    recorder: Recorder,
}

/// Summary of the time that scans took, preparation included, reading and decoding of files not. Milliseconds.
#[derive(Clone, Debug, Serialize)]
pub struct TimeSummary {
    /// From giving a scan to the mapper until it is integrated.
    pub integrate_ms: Spread,
    /// Processor time of all threads of the pool; `null` where the system does not tell.
    pub integrate_cpu_ms: Spread,
    /// Wall time by phase: `prepare` (range image, local planes) and the phases of each field.
    pub phases_ms: BTreeMap<String, Spread>,
}

impl Session {
    /// Mapping with `mapper` in `pool`.
    pub fn new(mapper: Mapper, pool: rayon::ThreadPool) -> Self {
        Self { mapper, pool, recorder: Recorder::default() }
    }

    /// Gives threads something to do that would have nothing to do otherwise, if there are any.
    pub fn in_spare_time(&mut self, chore: impl FnOnce() -> Chore) {
        if self.pool.current_num_threads() > 1 {
            self.mapper.set_chore(chore());
        }
    }

    /// Takes an event; a scan that was integrated gives a report.
    ///
    /// # Errors
    /// Those of the mapper: the event was refused and the map is as before.
    pub fn take(&mut self, event: Event) -> Result<Option<ScanReport>, MapError> {
        let seen = Recorder::look(&event, &self.mapper);
        let before = usage::pool_cpu_time(&self.pool);
        let clock = Instant::now();
        let mapper = &mut self.mapper;
        let done = self.pool.install(|| mapper.handle(event));
        let wall = clock.elapsed();
        if let Ok(report) = &done {
            let cpu = before.zip(usage::pool_cpu_time(&self.pool)).map(|(before, after)| after.saturating_sub(before));
            self.recorder.note(&seen, &Outcome { report: report.as_ref(), wall, cpu }, &self.mapper);
        }
        done
    }

    /// Notes for the log that the correction that comes next took this long to be found.
    #[cfg_attr(not(feature = "optimize"), allow(dead_code))]
    pub fn optimised(&mut self, took: Duration) {
        self.recorder.optimised(took);
    }

    /// Does the fusions that are under way or due.
    pub fn finish_fusions(&mut self) {
        let mapper = &mut self.mapper;
        self.pool.install(|| mapper.finish_fusions());
    }

    /// Finishes the map: fusions, and doubts between submaps.
    pub fn finish(&mut self) {
        let mapper = &mut self.mapper;
        self.pool.install(|| mapper.finish());
    }

    /// Makes a submap anew from its scans.
    ///
    /// # Errors
    /// When one of them cannot be read again; the submap is as before.
    pub fn rebuild(&mut self, id: SubmapId, source: &mut (dyn ScanSource + Send)) -> Result<RebuildReport, RebuildError> {
        let mapper = &mut self.mapper;
        self.pool.install(|| mapper.rebuild(id, source))
    }

    /// The mapper.
    pub fn mapper(&self) -> &Mapper {
        &self.mapper
    }

    /// Threads that it works with.
    pub fn threads(&self) -> usize {
        self.pool.current_num_threads()
    }

    /// The pool, for work on the finished map.
    pub fn pool(&self) -> &rayon::ThreadPool {
        &self.pool
    }

    /// Scans integrated so far.
    pub fn scans(&self) -> usize {
        self.recorder.log().scans.node.len()
    }

    /// The times of all scans so far.
    pub fn times(&self) -> TimeSummary {
        let log = self.recorder.log();
        TimeSummary {
            integrate_ms: Spread::of(&log.scans.wall_ms),
            integrate_cpu_ms: Spread::of(&log.scans.cpu_ms),
            phases_ms: log.phases_ms.iter().map(|(name, times)| (name.clone(), Spread::of(times))).collect(),
        }
    }

    /// How the run went so far, for a report. Totals of the command are left to the command.
    pub fn log(&self) -> RunLog {
        let counts = self.mapper.elastic_counts();
        RunLog {
            threads: self.threads(),
            fusions: counts.fusions,
            groups_apart: counts.groups_apart,
            submap_moves: counts.submap_moves,
            peak_rss_mb: usage::peak_resident_bytes().map(usage::megabytes),
            ..self.recorder.log().clone()
        }
    }
}
