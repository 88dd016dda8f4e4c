//! Input of an adapter: the scans as plain files, and a request that lists them.

use crate::data::Dataset;
use crate::error::{BenchError, Result};
use crate::run::Case;
use serde::Serialize;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;
use voxelastic::event::{Event, Scan};
use voxelastic::settings::Settings;
use voxelastic::{Cloud, Pose};

/// A scan in a request.
#[derive(Clone, Debug, Serialize)]
struct PeerScan {
    points: PathBuf,
    t_map_lidar: [f64; 7],
}

/// The request; see [`super`].
#[derive(Debug, Serialize)]
struct Request<'a> {
    format: u32,
    field: &'static str,
    voxel_m: f32,
    max_range_m: f32,
    min_range_m: f32,
    threads: usize,
    time_limit_s: f64,
    scans: &'a [PeerScan],
    surface: &'a Path,
}

/// The scans of a dataset, exported once for all peers and settings.
#[derive(Clone, Debug)]
pub(crate) struct ExportedScans {
    folder: PathBuf,
    scans: Vec<PeerScan>,
}

impl ExportedScans {
    /// Exports the returns of all scans to `folder`.
    pub fn write(data: &Dataset, folder: &Path) -> Result<Self> {
        fs::create_dir_all(folder).map_err(BenchError::file(folder))?;
        let source = data.open()?;
        let mut scans = Vec::new();
        for event in source.events() {
            if let Event::Scan(scan) = event? {
                scans.push(write_scan(&scan, &folder.join(format!("{:06}.bin", scans.len())))?);
            }
        }
        Ok(Self { folder: folder.to_path_buf(), scans })
    }

    /// Number of scans.
    pub fn len(&self) -> usize {
        self.scans.len()
    }

    /// Writes the request for `case` and returns its path.
    pub fn request(&self, case: &Case<'_>, limit: Duration, surface: &Path) -> Result<PathBuf> {
        let request = Request {
            format: 1,
            field: case.field.name(),
            voxel_m: case.setting.voxel,
            max_range_m: case.setting.max_range,
            min_range_m: Settings::default().min_range,
            threads: case.threads,
            time_limit_s: limit.as_secs_f64(),
            scans: &self.scans,
            surface,
        };
        let path = self.folder.join("request.json");
        let text = serde_json::to_string(&request).map_err(|e| BenchError::Answer { command: "request".to_owned(), problem: e.to_string() })?;
        fs::write(&path, text).map_err(BenchError::file(&path))?;
        Ok(path)
    }

    /// This many scans without files.
    #[cfg(test)]
    pub fn of(folder: &Path, scans: usize) -> Self {
        Self { folder: folder.into(), scans: vec![PeerScan { points: "none.bin".into(), t_map_lidar: [0.0; 7] }; scans] }
    }
}

fn write_scan(scan: &Scan, path: &Path) -> Result<PeerScan> {
    let returns = scan.cloud.points.iter().copied().filter(Cloud::is_return);
    let bytes: Vec<u8> = returns.flat_map(|[x, y, z]| [x, y, z, 0.0].map(f32::to_le_bytes)).flatten().collect();
    fs::write(path, bytes).map_err(BenchError::file(path))?;
    Ok(PeerScan { points: path.to_path_buf(), t_map_lidar: pose_numbers(&scan.t_map_lidar) })
}

fn pose_numbers(pose: &Pose) -> [f64; 7] {
    let (t, q) = (pose.translation.vector, pose.rotation.coords);
    [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
}
