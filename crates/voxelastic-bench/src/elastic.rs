//! What corrections and second visits cost, and the mesh of everything.

use crate::data::{Dataset, Truth, simulated};
use crate::error::{BenchError, Result};
use crate::peers::{NOT_THIS_FIELD, Peer, handout};
use crate::run::{Case, Run, Series};
use crate::setting::HARD;
use crate::workshop::{Workshop, words};
use serde::Serialize;
use std::time::{Duration, Instant};
use voxelastic::event::{Event, NodeId, Scan};
use voxelastic::settings::{FieldKind, Settings};
use voxelastic::{Mapper, Pose};
use voxelastic_eval::Spread;
use voxelastic_sim::{PoseSource, SimOptions, Simulation};

/// What was measured beside the runs.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Elastic {
    /// A correction of all poses of many submaps.
    pub pose_update: Option<PoseUpdate>,
    /// The same way twice.
    pub second_lap: Option<SecondLap>,
    /// The same in one submap, and by peers that map surfaces.
    pub second_lap_others: Vec<SecondLap>,
    /// The mesh of the campus at the hardest setting.
    pub mesh: Option<MeshTime>,
}

/// A correction that moves every submap.
#[derive(Clone, Debug, Serialize)]
pub struct PoseUpdate {
    /// Submaps.
    pub submaps: usize,
    /// Wall time of an update, milliseconds, over [`UPDATES`] of them.
    pub wall_ms: Spread,
}

/// The same way twice, at the hardest setting, TSDF.
#[derive(Clone, Debug, Serialize)]
pub struct SecondLap {
    /// `voxelastic`, or the name of a peer.
    pub system: String,
    /// Scans of a lap.
    pub scans: usize,
    /// The command that mapped both laps.
    pub command: String,
    /// Memory of the map after the first lap, at rest, megabytes; of a peer that does not tell, the most that its process had taken.
    pub first_mb: f64,
    /// Memory of the map after the second.
    pub second_mb: f64,
    /// What the second added, as a share of the first.
    pub added: f64,
    /// Submaps after the first lap.
    pub first_submaps: u32,
    /// Submaps after the second.
    pub second_submaps: u32,
    /// Mean processor time of a scan of the second lap over that of the first.
    pub slower: f64,
}

/// What a mesh took, on one thread.
#[derive(Clone, Debug, Serialize)]
pub struct MeshTime {
    /// From the map in memory to the mesh in memory, seconds of wall time.
    pub extract_s: f64,
    /// Triangles.
    pub triangles: u64,
}

/// Updates that are timed.
pub const UPDATES: usize = 20;

/// Times corrections of this many submaps each. In this process: a thousand small submaps take no memory to speak of.
pub(crate) fn pose_updates(submaps: &[usize]) -> Result<Vec<PoseUpdate>> {
    submaps.iter().map(|&count| pose_update(count)).collect()
}

fn pose_update(submaps: usize) -> Result<PoseUpdate> {
    let failed = |e: &dyn std::fmt::Display| BenchError::Simulation(e.to_string());
    // The sensor stays in one room, but says that it went 10 m from scan to scan: one submap each.
    let options = SimOptions { sensor: "vlp-16".into(), columns: Some(64), scans: Some(1), ..SimOptions::of("room") };
    let cloud = Simulation::new(options).map_err(|e| failed(&e))?.scans(PoseSource::Truth).next().map(|s| s.cloud).unwrap_or_default();
    let settings = Settings { voxel: 0.5, lambda_odom: 5.0, min_overlap: 1.0, sensor: "auto".into(), ..Settings::default() };
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
    Ok(PoseUpdate { submaps, wall_ms: Spread::of(&times) })
}

/// Walks round the campus once and twice, with true poses: as usual, in one submap, and with `peers`, each for `limit` at most. What went wrong with a
/// peer is added to `skipped`.
pub(crate) fn second_laps(shop: &Workshop, peers: &[Peer], limit: Duration, skipped: &mut Vec<String>) -> Result<(SecondLap, Vec<SecondLap>)> {
    let folder = simulated(shop, "laps", &["campus", "--laps", "2"])?;
    let scans = Simulation::load(&folder).map_err(|e| BenchError::Simulation(e.to_string()))?.len() / 2;
    let data = Dataset { name: "two laps".to_owned(), folder, poses: Some("groundtruth"), truth: Truth::None, max_scans: None };
    let case = Case { data: &data, setting: HARD, field: FieldKind::Tsdf, threads: 1, one_submap: false };
    let one_lap = Dataset { max_scans: Some(scans), ..data.clone() };
    let ours = |one_submap: bool| {
        let run = |data| {
            let run = Case { data, one_submap, ..case }.run(shop, "laps.vox");
            shop.discard("laps.vox");
            run
        };
        let (first, both) = (run(&one_lap)?, run(&data)?);
        let at_rest = first.map_mb.zip(both.map_mb);
        SecondLap::of(both, scans, at_rest)
    };
    let (usual, mut others) = (ours(false)?, vec![ours(true)?]);
    if !peers.is_empty() {
        let handout = handout(&data, &shop.scratch("handout"))?;
        for peer in peers {
            tracing::info!("{}, {}", data.name, peer.name);
            let run = peer.run(shop, &case, &handout, limit);
            match run.and_then(|run| if run.note == NOT_THIS_FIELD { Ok(None) } else { SecondLap::of(run, scans, None).map(Some) }) {
                Ok(lap) => others.extend(lap),
                Err(problem) => skipped.push(format!("{}, {}: {problem}", data.name, peer.name)),
            }
        }
        shop.discard("handout");
    }
    Ok((usual, others))
}

impl SecondLap {
    /// What `run` of two laps of `scans` scans each tells. `at_rest` is the memory of a map of one lap and of two, once all of it is at rest: while
    /// mapping goes on, some of it is awake, and how much says nothing of laps. Peers' maps are as they are.
    fn of(run: Run, scans: usize, at_rest: Option<(f64, f64)>) -> Result<Self> {
        let Series { cpu_ms, map_mb, peak_mb, submaps, .. } = run.series;
        let what = if run.note.is_empty() { format!("only {} scans", run.scans) } else { run.note };
        let short = || BenchError::Answer { command: run.command.clone(), what: what.clone() };
        if cpu_ms.len() != 2 * scans {
            return Err(short());
        }
        let at = |values: &[f64]| Some((*values.get(scans - 1)?, *values.last()?));
        let (first_mb, second_mb) = at_rest.or_else(|| at(&map_mb)).or_else(|| at(&peak_mb)).ok_or_else(short)?;
        let (first, second) = cpu_ms.split_at(scans);
        Ok(Self {
            first_mb,
            second_mb,
            added: second_mb / first_mb - 1.0,
            first_submaps: submaps.get(scans - 1).copied().unwrap_or(1),
            second_submaps: submaps.last().copied().unwrap_or(1),
            slower: Spread::of(second).mean.zip(Spread::of(first).mean).map(|(second, first)| second / first).ok_or_else(short)?,
            system: run.system,
            scans,
            command: run.command,
        })
    }
}

/// Meshes the map `name` of the workshop's scratch.
pub(crate) fn mesh(shop: &Workshop, name: &str) -> Result<MeshTime> {
    let (map, mesh) = (shop.scratch(name).display().to_string(), shop.scratch("mesh.ply").display().to_string());
    let arguments = words(&["mesh", &map, "-o", &mesh, "--threads", "1", "--json"]);
    let answer = shop.ask(&arguments)?;
    shop.discard("mesh.ply");
    let missing = || BenchError::Answer { command: Workshop::told(&arguments), what: "no `extract_s` or `triangles`".to_owned() };
    let extract_s = answer["extract_s"].as_f64().ok_or_else(missing)?;
    Ok(MeshTime { extract_s, triangles: answer["triangles"].as_u64().ok_or_else(missing)? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_lap_is_held_against_the_first() {
        let series = Series { cpu_ms: vec![2.0, 2.0, 3.0, 3.0], map_mb: vec![5.0, 8.0, 9.0, 10.0], ..Series::default() };
        let run = |series: Series| Run { scans: series.cpu_ms.len(), series, ..Run::default() };
        let lap = SecondLap::of(run(series.clone()), 2, None).unwrap();
        assert_eq!((lap.first_mb, lap.second_mb, lap.added, lap.slower), (8.0, 10.0, 0.25, 1.5));
        // What maps take at rest comes before what they took when they were made.
        let at_rest = SecondLap::of(run(series.clone()), 2, Some((4.0, 4.5))).unwrap();
        assert_eq!((at_rest.first_mb, at_rest.second_mb, at_rest.added, at_rest.slower), (4.0, 4.5, 0.125, 1.5));
        // A peer that tells only what its process takes; one that did not come so far.
        let peer = Series { peak_mb: vec![100.0, 200.0, 201.0, 210.0], map_mb: Vec::new(), ..series.clone() };
        assert_eq!(SecondLap::of(run(peer), 2, None).unwrap().second_mb, 210.0);
        assert!(SecondLap::of(run(series), 3, None).unwrap_err().to_string().contains("only 4 scans"));
    }

    #[test]
    fn every_submap_is_moved_by_every_update() {
        let found = pose_updates(&[1, 12]).unwrap();
        assert_eq!(found.iter().map(|f| f.submaps).collect::<Vec<_>>(), [1, 12]);
        assert!(found.iter().all(|f| f.wall_ms.median.is_some_and(|ms| ms < 1000.0)));
    }
}
