//! The elastic part as a whole: fusion against direct integration, laps, corrections, bad input (paper Sec. IV).
#![allow(clippy::print_stdout)]

mod bad_input;
mod correction;
mod fusion;
mod laps;
mod moving;
mod town;

use voxelastic::Settings;
use voxelastic::atlas::Atlas;
use voxelastic::field::tsdf::Voxel;

/// Settings for the town: coarse and fast.
fn settings() -> Settings {
    Settings { voxel_size: 0.2, max_range: 30.0, sensor: "vlp-16".into(), lambda_odom: 20.0, lambda_cluster: 10.0, ..Settings::default() }
}

/// The content of a TSDF atlas, for comparison.
fn image(atlas: &Atlas) -> Vec<(u32, Vec<u64>, Vec<Vec<Voxel>>)> {
    let of_submap = |s: &voxelastic::atlas::Submap| {
        let nodes = s.scans().iter().map(|scan| scan.node).collect();
        let ids = s.tsdf().ids_in_morton_order();
        (s.id(), nodes, ids.into_iter().map(|id| s.tsdf().stored_voxels(id)).collect())
    };
    atlas.submaps().iter().map(of_submap).collect()
}
