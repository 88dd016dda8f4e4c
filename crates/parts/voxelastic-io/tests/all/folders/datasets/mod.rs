//! Folders of clouds and poses: found, matched, streamed; and what is answered when they are wrong.

mod bad;
mod detect;
mod stream;

use std::path::{Path, PathBuf};
use tempfile::TempDir;
use voxelastic::event::{Edge, Event, NodeId};
use voxelastic::{Cloud, Pose};
use voxelastic_io::dataset::{self, Dataset, OpenOptions};
use voxelastic_io::{PoseGraph, Result, pcd, poses};

/// A folder that is deleted after the test.
struct Folder(TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    /// A folder of `count` clouds `scans/000000.pcd`, .. whose k-th point is at (k + 1, 0, 0).
    fn with_scans(count: usize) -> Self {
        let folder = Self::new();
        (0..count).for_each(|k| folder.cloud(&format!("scans/{k:06}.pcd"), k));
        folder
    }

    fn path(&self) -> &Path {
        self.0.path()
    }

    fn file(&self, name: &str) -> PathBuf {
        self.path().join(name)
    }

    fn cloud(&self, name: &str, k: usize) {
        pcd::write(self.file(name), &Cloud::from_points(vec![[k as f32 + 1.0, 0.0, 0.0]])).unwrap();
    }

    fn text(&self, name: &str, text: &str) {
        std::fs::write(self.file(name), text).unwrap();
    }

    /// TUM poses at x = 2 k + `x0`, one per `dt` seconds from `t0`.
    fn tum(&self, name: &str, count: usize, t0: f64, dt: f64, x0: f64) {
        let pose = |k: usize| (t0 + dt * k as f64, pose(2.0 * k as f64 + x0));
        poses::write_tum(self.file(name), &(0..count).map(pose).collect::<Vec<_>>()).unwrap();
    }

    fn kitti(&self, name: &str, count: usize, x0: f64) {
        poses::write_kitti(self.file(name), &(0..count).map(|k| pose(2.0 * k as f64 + x0)).collect::<Vec<_>>()).unwrap();
    }

    fn open(&self) -> Result<Dataset> {
        dataset::open(self.path(), &OpenOptions::default())
    }

    fn open_with(&self, options: OpenOptions) -> Result<Dataset> {
        dataset::open(self.path(), &options)
    }

    /// The message of an error that opening must give.
    fn refusal(&self) -> String {
        self.open().expect_err("opened").to_string()
    }
}

fn pose(x: f64) -> Pose {
    Pose::translation(x, 0.0, 0.0)
}

fn with_poses(poses: &str) -> OpenOptions {
    OpenOptions { poses: Some(poses.into()), ..OpenOptions::default() }
}

fn edge(from: NodeId, to: NodeId, x: f64) -> Edge {
    Edge { from, to, t_from_to: pose(x), information: Some([1.0; 21]) }
}

/// A chain of nodes with measured odometry (2.5 m a step) and the given loop edges.
fn graph(ids: &[NodeId], loops: &[(NodeId, NodeId)]) -> PoseGraph {
    let nodes = ids.iter().enumerate().map(|(k, id)| (*id, pose(2.0 * k as f64))).collect();
    let odometry = ids.windows(2).map(|w| edge(w[0], w[1], 2.5));
    PoseGraph { nodes, edges: odometry.chain(loops.iter().map(|(a, b)| edge(*a, *b, 0.1))).collect(), fixed: vec![ids[0]] }
}

/// Events in short: `S3` scan of node 3, `O3-4` odometry, `L9-0` loop edge, `U2` update of two poses, `!` error.
fn story(dataset: &Dataset) -> String {
    let word = |event: Result<Event>| match event {
        Ok(Event::Scan(scan)) => format!("S{}", scan.node),
        Ok(Event::OdometryEdge(edge)) => format!("O{}-{}", edge.from, edge.to),
        Ok(Event::LoopEdge(edge)) => format!("L{}-{}", edge.from, edge.to),
        Ok(Event::PoseUpdate(poses)) => format!("U{}", poses.len()),
        Ok(other) => format!("{other:?}"),
        Err(_) => "!".into(),
    };
    dataset.events().map(word).collect::<Vec<_>>().join(" ")
}

fn xs(dataset: &Dataset) -> Vec<f64> {
    dataset.scans().iter().map(|s| s.t_map_lidar.translation.x).collect()
}
