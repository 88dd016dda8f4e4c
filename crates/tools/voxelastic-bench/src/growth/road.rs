//! Costs of new road, and their extrapolation to a long drive.

use crate::data::{Dataset, real, simulated};
use crate::error::Result;
use crate::run::Case;
use crate::setting::{FIELDS, HARDEST, SETTINGS, Setting};
use crate::workspace::Workspace;
use serde::Serialize;
use std::path::Path;
use voxelastic::event::Event;
use voxelastic::settings::FieldKind;

/// Costs per kilometre of road that was not mapped before.
#[derive(Clone, Debug, Serialize)]
pub struct Road {
    /// The dataset: `street` (KITTI), or `simulated street` if that is not available.
    pub data: String,
    /// `tsdf` or `occupancy`.
    pub field: String,
    /// Largest range, metres.
    pub max_range_m: f32,
    /// Finest voxel, metres.
    pub voxel_m: f32,
    /// Length of the measured road, metres.
    pub path_m: f64,
    /// Scans per kilometre.
    pub scans_per_km: f64,
    /// Processor time per kilometre, seconds.
    pub cpu_s_per_km: f64,
    /// Memory per kilometre, megabytes.
    pub map_mb_per_km: f64,
    /// Disk space per kilometre, megabytes.
    pub file_mb_per_km: f64,
}

impl Road {
    /// Hours of one core, gigabytes in memory and gigabytes on disk for a drive of this many kilometres without revisits.
    pub fn drive(&self, km: f64) -> [f64; 3] {
        [self.cpu_s_per_km * km / 3600.0, self.map_mb_per_km * km / 1e3, self.file_mb_per_km * km / 1e3]
    }
}

/// Scans of the simulated street: less than one round.
const SCANS: &str = "100";

/// Costs at the hardest setting and at the one with coarse voxels.
pub(super) fn roads(workspace: &Workspace, real_data: &Path) -> Result<Vec<Road>> {
    let found = real(real_data).0.into_iter().find(|d| d.name == "street");
    let data = match found {
        Some(data) => data,
        None => Dataset::simulated("simulated street", simulated(workspace, "road", &["street", "--scans", SCANS, "--drift", "0"])?),
    };
    let path = path_of(&data)?;
    let mut roads = Vec::new();
    for setting in [HARDEST, SETTINGS[1]] {
        for field in FIELDS {
            roads.extend(road(workspace, &data, setting, field, &path)?);
        }
    }
    Ok(roads)
}

/// Path length up to each scan, metres.
fn path_of(data: &Dataset) -> Result<Vec<f64>> {
    let (mut path, mut last) = (Vec::new(), None);
    for event in data.open()?.events() {
        if let Event::Scan(scan) = event? {
            let here = scan.t_map_lidar.translation.vector;
            let step = last.replace(here).map_or(0.0, |before| (here - before).norm());
            path.push(path.last().unwrap_or(&0.0) + step);
        }
    }
    Ok(path)
}

/// Costs of the second half of the road; none if there are too few scans. The first half is left out, because the initial view is mapped there.
fn road(workspace: &Workspace, data: &Dataset, setting: Setting, field: FieldKind, path: &[f64]) -> Result<Option<Road>> {
    tracing::info!("{}, {setting}, {}", data.name, field.name());
    let run = Case { data, setting, field, threads: 1, one_submap: false }.run(workspace, "road.vox")?;
    workspace.remove_scratch("road.vox");
    let (memory, cpu) = (&run.series.map_mb, &run.series.cpu_ms);
    let (middle, end) = (path.len() / 2, path.len().saturating_sub(1));
    let (Some(from), Some(to)) = (memory.get(middle), memory.get(end)) else { return Ok(None) };
    let km = (path[end] - path[middle]) / 1e3;
    if km <= 0.0 || cpu.len() < path.len() {
        return Ok(None);
    }
    let map_mb_per_km = (to - from) / km;
    let on_disk = run.file_mb.zip(run.map_mb).map_or(0.0, |(file, map)| file / map.max(1e-9));
    Ok(Some(Road {
        data: data.name.clone(),
        field: field.name().to_owned(),
        max_range_m: setting.max_range,
        voxel_m: setting.voxel,
        path_m: path[end],
        scans_per_km: (end - middle) as f64 / km,
        cpu_s_per_km: cpu[middle + 1..=end].iter().sum::<f64>() / 1e3 / km,
        map_mb_per_km,
        file_mb_per_km: map_mb_per_km * on_disk,
    }))
}
