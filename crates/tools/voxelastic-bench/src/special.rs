//! Measurements besides the runs: pose updates, second laps, mesh extraction.

use crate::data::{Dataset, Truth, simulated};
use crate::error::{BenchError, Result};
use crate::peers::{NOT_THIS_FIELD, Peer, export_scans};
use crate::run::{Case, Run, Series};
use crate::setting::HARDEST;
use crate::workspace::{Workspace, words};
use serde::Serialize;
use std::time::{Duration, Instant};
use voxelastic::event::{Event, NodeId, Scan};
use voxelastic::settings::{FieldKind, Settings};
use voxelastic::{Mapper, Pose};
use voxelastic_eval::SeriesStats;
use voxelastic_sim::{PoseSource, SimOptions, Simulation};

/// Measurements besides the runs.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Special {
    /// A pose update of many submaps.
    pub pose_update: Option<PoseUpdate>,
    /// A second lap on the same route.
    pub second_lap: Option<SecondLap>,
    /// The same with one submap, and by peers that map surfaces.
    pub second_lap_others: Vec<SecondLap>,
    /// Mesh extraction of the campus at the hardest setting.
    pub mesh: Option<MeshTime>,
}

/// A pose update that moves every submap.
#[derive(Clone, Debug, Serialize)]
pub struct PoseUpdate {
    /// Number of submaps.
    pub submaps: usize,
    /// Wall time of an update, milliseconds, over [`UPDATES`] updates.
    pub wall_ms: SeriesStats,
}

/// Two laps on the same route at the hardest setting, TSDF.
#[derive(Clone, Debug, Serialize)]
pub struct SecondLap {
    /// `voxelastic`, or the name of a peer.
    pub system: String,
    /// Scans per lap.
    pub scans: usize,
    /// The command that mapped both laps.
    pub command: String,
    /// Memory of the finished map of one lap, megabytes; for a peer that does not report it, the peak memory of its process after the first lap.
    pub first_mb: f64,
    /// Likewise for two laps.
    pub second_mb: f64,
    /// Increase by the second lap as a share of the first.
    pub added: f64,
    /// Submaps after the first lap.
    pub first_submaps: u32,
    /// Submaps after the second.
    pub second_submaps: u32,
    /// Mean processor time of a scan of the second lap over that of the first.
    pub slower: f64,
}

/// Mesh extraction on one thread.
#[derive(Clone, Debug, Serialize)]
pub struct MeshTime {
    /// Wall time from the map in memory to the mesh in memory, seconds.
    pub extract_s: f64,
    /// Triangles.
    pub triangles: u64,
}

/// Number of timed updates.
pub const UPDATES: usize = 20;

/// Times pose updates for several numbers of submaps. Runs in this process, because a thousand small submaps take little memory.
pub(crate) fn pose_updates(submaps: &[usize]) -> Result<Vec<PoseUpdate>> {
    submaps.iter().map(|&count| pose_update(count)).collect()
}

fn pose_update(submaps: usize) -> Result<PoseUpdate> {
    let failed = |e: &dyn std::fmt::Display| BenchError::Simulation(e.to_string());
    // The same scan of a room at poses 10 m apart: one submap each.
    let options = SimOptions { sensor: "vlp-16".into(), columns: Some(64), scans: Some(1), ..SimOptions::of("room") };
    let cloud = Simulation::new(options).map_err(|e| failed(&e))?.scans(PoseSource::Truth).next().map(|s| s.cloud).unwrap_or_default();
    let settings = Settings { voxel_size: 0.5, lambda_odom: 5.0, min_overlap: 1.0, sensor: "auto".into(), ..Settings::default() };
    let mut mapper = Mapper::new(settings).map_err(|e| failed(&e))?;
    let pose = |node: NodeId, shift: f64| Pose::translation(10.0 * node as f64, shift, 0.0);
    for node in 0..submaps as NodeId {
        let scan = Scan { node, time: node as f64, t_map_lidar: pose(node, 0.0), cloud: cloud.clone() };
        mapper.handle(Event::Scan(scan)).map_err(|e| failed(&e))?;
    }
    let found = mapper.atlas().submaps().len();
    if found != submaps {
        return Err(BenchError::Simulation(format!("{found} submaps instead of {submaps}")));
    }
    let mut times = Vec::new();
    for update in 1..=UPDATES {
        let event = Event::PoseUpdate((0..submaps as NodeId).map(|node| (node, pose(node, update as f64))).collect());
        let clock = Instant::now();
        mapper.handle(event).map_err(|e| failed(&e))?;
        times.push(clock.elapsed().as_secs_f64() * 1e3);
    }
    let moved = mapper.elastic_counts().submap_moves;
    if moved != UPDATES * submaps {
        return Err(BenchError::Simulation(format!("{moved} submaps were moved instead of {}", UPDATES * submaps)));
    }
    Ok(PoseUpdate { submaps, wall_ms: SeriesStats::new(&times) })
}

/// Maps one and two laps of the campus with true poses: with default submaps, with one submap, and by `peers` within `limit`. Failures of peers are added
/// to `skipped`.
pub(crate) fn second_laps(workspace: &Workspace, peers: &[Peer], limit: Duration, skipped: &mut Vec<String>) -> Result<(SecondLap, Vec<SecondLap>)> {
    let folder = simulated(workspace, "laps", &["campus", "--laps", "2"])?;
    let scans = Simulation::load(&folder).map_err(|e| BenchError::Simulation(e.to_string()))?.len() / 2;
    let data = Dataset { name: "two laps".to_owned(), folder, poses: Some("groundtruth"), truth: Truth::None, max_scans: None };
    let case = Case { data: &data, setting: HARDEST, field: FieldKind::Tsdf, threads: 1, one_submap: false };
    let one_lap = Dataset { max_scans: Some(scans), ..data.clone() };
    let ours = |one_submap: bool| {
        let run = |data| {
            let run = Case { data, one_submap, ..case }.run(workspace, "laps.vox");
            workspace.remove_scratch("laps.vox");
            run
        };
        let (first, both) = (run(&one_lap)?, run(&data)?);
        let finished = first.map_mb.zip(both.map_mb);
        SecondLap::new(both, scans, finished)
    };
    let (default, mut others) = (ours(false)?, vec![ours(true)?]);
    if !peers.is_empty() {
        let exported = export_scans(&data, &workspace.scratch("exported"))?;
        for peer in peers {
            tracing::info!("{}, {}", data.name, peer.name);
            let run = peer.run(workspace, &case, &exported, limit);
            match run.and_then(|run| if run.note == NOT_THIS_FIELD { Ok(None) } else { SecondLap::new(run, scans, None).map(Some) }) {
                Ok(lap) => others.extend(lap),
                Err(problem) => skipped.push(format!("{}, {}: {problem}", data.name, peer.name)),
            }
        }
        workspace.remove_scratch("exported");
    }
    Ok((default, others))
}

impl SecondLap {
    /// Evaluates `run` of two laps of `scans` scans each. `finished` is the memory of the finished maps of one and two laps: while mapping, some
    /// blocks are not compacted yet, which says nothing about laps. For peers it is none.
    fn new(run: Run, scans: usize, finished: Option<(f64, f64)>) -> Result<Self> {
        let Series { cpu_ms, map_mb, peak_mb, submaps, .. } = run.series;
        let problem = if run.note.is_empty() { format!("only {} scans", run.scans) } else { run.note };
        let short = || BenchError::Answer { command: run.command.clone(), problem: problem.clone() };
        if cpu_ms.len() != 2 * scans {
            return Err(short());
        }
        let at = |values: &[f64]| Some((*values.get(scans - 1)?, *values.last()?));
        let (first_mb, second_mb) = finished.or_else(|| at(&map_mb)).or_else(|| at(&peak_mb)).ok_or_else(short)?;
        let (first, second) = cpu_ms.split_at(scans);
        Ok(Self {
            first_mb,
            second_mb,
            added: second_mb / first_mb - 1.0,
            first_submaps: submaps.get(scans - 1).copied().unwrap_or(1),
            second_submaps: submaps.last().copied().unwrap_or(1),
            slower: SeriesStats::new(second).mean.zip(SeriesStats::new(first).mean).map(|(second, first)| second / first).ok_or_else(short)?,
            system: run.system,
            scans,
            command: run.command,
        })
    }
}

/// Times mesh extraction of the map `name` in the workspace's scratch.
pub(crate) fn mesh(workspace: &Workspace, name: &str) -> Result<MeshTime> {
    let (map, mesh) = (workspace.scratch(name).display().to_string(), workspace.scratch("mesh.ply").display().to_string());
    let arguments = words(&["mesh", &map, "-o", &mesh, "--threads", "1", "--json"]);
    let answer = workspace.run_json(&arguments)?;
    workspace.remove_scratch("mesh.ply");
    let missing = || BenchError::Answer { command: Workspace::command_line(&arguments), problem: "no `extract_s` or `triangles`".to_owned() };
    let extract_s = answer["extract_s"].as_f64().ok_or_else(missing)?;
    Ok(MeshTime { extract_s, triangles: answer["triangles"].as_u64().ok_or_else(missing)? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn second_lap_is_compared_with_the_first() {
        let series = Series { cpu_ms: vec![2.0, 2.0, 3.0, 3.0], map_mb: vec![5.0, 8.0, 9.0, 10.0], ..Series::default() };
        let run = |series: Series| Run { scans: series.cpu_ms.len(), series, ..Run::default() };
        let lap = SecondLap::new(run(series.clone()), 2, None).unwrap();
        assert_eq!((lap.first_mb, lap.second_mb, lap.added, lap.slower), (8.0, 10.0, 0.25, 1.5));
        // The memory of finished maps has priority over that while mapping.
        let finished = SecondLap::new(run(series.clone()), 2, Some((4.0, 4.5))).unwrap();
        assert_eq!((finished.first_mb, finished.second_mb, finished.added, finished.slower), (4.0, 4.5, 0.125, 1.5));
        // A peer that reports only the memory of its process; one that did not finish.
        let peer = Series { peak_mb: vec![100.0, 200.0, 201.0, 210.0], map_mb: Vec::new(), ..series.clone() };
        assert_eq!(SecondLap::new(run(peer), 2, None).unwrap().second_mb, 210.0);
        assert!(SecondLap::new(run(series), 3, None).unwrap_err().to_string().contains("only 4 scans"));
    }

    #[test]
    fn every_update_moves_every_submap() {
        let found = pose_updates(&[1, 12]).unwrap();
        assert_eq!(found.iter().map(|f| f.submaps).collect::<Vec<_>>(), [1, 12]);
        assert!(found.iter().all(|f| f.wall_ms.median.is_some()));
    }
}
