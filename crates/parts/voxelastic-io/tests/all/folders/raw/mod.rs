//! Scans without poses: folders of every layout, recordings, and folders that cannot be read.

mod bad;
mod layouts;

use std::path::{Path, PathBuf};
use tempfile::TempDir;
use voxelastic::Cloud;
use voxelastic_io::raw::{self, RawScans, TimedScan};
use voxelastic_io::{OpenOptions, Result, pcd};

/// A folder that is deleted after the test.
struct Folder(TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self) -> &Path {
        self.0.path()
    }

    fn file(&self, name: &str) -> PathBuf {
        self.path().join(name)
    }

    fn write(&self, name: &str, bytes: &[u8]) {
        let path = self.file(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }

    /// A PCD cloud whose only point is at x = k + 1.
    fn pcd(&self, name: &str, k: usize) {
        pcd::write(self.file(name), &cloud(k)).unwrap();
    }

    /// The same as floats: `x y z` and then `extra` more numbers a point.
    fn bin(&self, name: &str, k: usize, extra: usize) {
        let mut numbers = vec![k as f32 + 1.0, 0.0, 0.0];
        numbers.resize(3 + extra, 7.0);
        self.write(name, &numbers.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>());
    }

    fn open(&self) -> Result<RawScans> {
        raw::open(self.path(), &OpenOptions::default())
    }

    /// All scans; every cloud must be the one of its index.
    fn scans(&self) -> Vec<TimedScan> {
        let opened = self.open().unwrap_or_else(|e| panic!("{e}"));
        let scans: Vec<TimedScan> = opened.iter().map(|scan| scan.unwrap()).collect();
        assert_eq!(opened.count(), Some(scans.len()));
        let mut again = opened.clouds();
        for (k, scan) in scans.iter().enumerate() {
            assert_eq!((scan.index, scan.cloud.points[0][0]), (k, k as f32 + 1.0), "{}", scan.name);
            assert_eq!(again.cloud(scan.node).unwrap().points, scan.cloud.points);
        }
        scans
    }

    /// The message of an error that opening must give.
    fn refusal(&self) -> String {
        self.open().expect_err("opened").to_string()
    }
}

fn cloud(k: usize) -> Cloud {
    Cloud::from_points(vec![[k as f32 + 1.0, 0.0, 0.0]])
}

fn times(scans: &[TimedScan]) -> Vec<f64> {
    scans.iter().map(|s| s.time).collect()
}

fn names(scans: &[TimedScan]) -> Vec<&str> {
    scans.iter().map(|s| s.name.as_str()).collect()
}
