//! Mapping under way: events into the mapper, in a pool of threads of its own, with the time that each scan took.

use crate::output::Spread;
use crate::usage;
use serde::Serialize;
use std::collections::BTreeMap;
use std::time::{Duration, Instant};
use voxelastic::atlas::SubmapId;
use voxelastic::event::Event;
use voxelastic::mapper::{MapError, Mapper, RebuildError, RebuildReport, ScanReport, ScanSource};

/// A mapper at work.
pub struct Session {
    mapper: Mapper,
    pool: rayon::ThreadPool,
    times: Times,
}

/// Milliseconds of each integrated scan.
#[derive(Debug, Default)]
struct Times {
    wall: Vec<f64>,
    cpu: Vec<f64>,
    phases: BTreeMap<&'static str, Vec<f64>>,
}

/// Summary of the time that scans took, preparation included, reading and decoding of files not. Milliseconds.
#[derive(Clone, Debug, Serialize)]
pub struct TimeSummary {
    /// From giving a scan to the mapper until it is integrated.
    pub integrate_ms: Spread,
    /// Processor time of all threads of the pool; `null` where the system does not tell.
    pub integrate_cpu_ms: Spread,
    /// Wall time by phase: `prepare` (range image, local planes) and the phases of each field.
    pub phases_ms: BTreeMap<&'static str, Spread>,
}

impl Session {
    /// Mapping with `mapper` in `pool`.
    pub fn new(mapper: Mapper, pool: rayon::ThreadPool) -> Self {
        Self { mapper, pool, times: Times::default() }
    }

    /// Takes an event; a scan that was integrated gives a report.
    ///
    /// # Errors
    /// Those of the mapper: the event was refused and the map is as before.
    pub fn take(&mut self, event: Event) -> Result<Option<ScanReport>, MapError> {
        let before = usage::pool_cpu_time(&self.pool);
        let clock = Instant::now();
        let mapper = &mut self.mapper;
        let done = self.pool.install(|| mapper.handle(event));
        let wall = clock.elapsed();
        if let Ok(Some(report)) = &done {
            let cpu = before.zip(usage::pool_cpu_time(&self.pool)).map(|(before, after)| after.saturating_sub(before));
            self.times.add(report, wall, cpu);
        }
        done
    }

    /// Finishes the fusions that are under way.
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
        self.times.wall.len()
    }

    /// The times of all scans so far.
    pub fn times(&self) -> TimeSummary {
        let Times { wall, cpu, phases } = &self.times;
        TimeSummary {
            integrate_ms: Spread::of(wall),
            integrate_cpu_ms: Spread::of(cpu),
            phases_ms: phases.iter().map(|(&name, times)| (name, Spread::of(times))).collect(),
        }
    }
}

impl Times {
    fn add(&mut self, report: &ScanReport, wall: Duration, cpu: Option<Duration>) {
        self.wall.push(milliseconds(wall));
        self.cpu.extend(cpu.map(milliseconds));
        let mut phase = |name: &'static str, time: Duration| self.phases.entry(name).or_default().push(milliseconds(time));
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
    time.as_secs_f64() * 1e3
}
