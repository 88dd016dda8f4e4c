//! What a map is made of: settings, sensor, and the table of submaps with where they lie.

use super::files::SubmapName;
use super::submap_file::{Expected, Fields, Written};
use crate::{Error, Result};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use voxelastic::atlas::{Submap, SubmapId, SubmapScan};
use voxelastic::event::NodeId;
use voxelastic::octree::SCALES;
use voxelastic::{Pose, Settings};

/// The content of a map's `manifest.json`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Manifest {
    /// How the map was made.
    pub details: MapDetails,
    /// The submaps, ordered by id.
    pub submaps: Vec<SubmapEntry>,
}

impl Manifest {
    /// Edge of the finest voxel as the settings in the manifest have it, metres; the default if they do not.
    pub(super) fn voxel_size(&self) -> f32 {
        let mut settings = Settings::default();
        for key in ["voxel", "voxel_size"] {
            if let Some(value) = self.details.settings.get(key) {
                // A value that is no voxel size is refused where the settings are read.
                let _ = settings.set(key, value);
            }
        }
        settings.voxel_size
    }
}

/// How a map was made, in words: stored and given back as it is.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MapDetails {
    /// Program and version that wrote the map.
    pub generator: String,
    /// Settings by key.
    pub settings: BTreeMap<String, String>,
    /// Description of the sensor, by key.
    pub sensor: BTreeMap<String, String>,
}

/// One submap in the manifest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SubmapEntry {
    /// Its identifier.
    pub id: SubmapId,
    /// Name of its file in the map directory.
    pub file: String,
    /// Size of the file.
    pub bytes: u64,
    /// CRC-32 of the whole file.
    pub crc32: u32,
    /// Root pose: the submap frame in the map frame.
    #[serde(with = "pose_as_numbers")]
    pub t_map_submap: Pose,
    /// Path length from the root pose to the last scan, metres.
    pub travelled: f64,
    /// Content of the TSDF, for information; absent when the submap has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tsdf: Option<TsdfSummary>,
    /// Content of the occupancy field, for information; absent when the submap has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub occupancy: Option<OccupancySummary>,
    /// The scans that it was made from, in the order in which they were integrated.
    pub scans: Vec<ScanEntry>,
}

/// Size of a submap's TSDF.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TsdfSummary {
    /// Blocks integrated at scales 0 to 3.
    pub blocks_by_scale: [u64; SCALES],
    /// Bytes in memory when the map was saved.
    pub memory_bytes: u64,
}

/// Size of a submap's occupancy field.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OccupancySummary {
    /// Octants of the tree.
    pub octants: u64,
    /// Blocks that hold voxels at scales 0 to 3.
    pub blocks_by_scale: [u64; SCALES],
    /// Bytes in memory when the map was saved.
    pub memory_bytes: u64,
}

/// A scan that a submap was made from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScanEntry {
    /// The pose-graph node where it was taken.
    pub node: NodeId,
    /// Pose of the lidar in the submap's frame.
    #[serde(with = "pose_as_numbers")]
    pub t_submap_lidar: Pose,
}

/// A submap, and where it lies.
#[derive(Clone, Copy, Debug)]
pub(super) struct Piece<'a> {
    pub submap: &'a Submap,
    pub t_map_submap: Pose,
}

impl SubmapEntry {
    /// The entry of a submap whose file is `name`.
    pub(super) fn new(piece: &Piece<'_>, name: SubmapName, written: Written) -> Self {
        let submap = piece.submap;
        let (tsdf, occupancy) = (submap.tsdf(), submap.occupancy());
        let of_tsdf = || TsdfSummary { blocks_by_scale: tsdf.blocks_by_scale().map(|n| n as u64), memory_bytes: tsdf.bytes() as u64 };
        let of_occupancy = || OccupancySummary {
            octants: occupancy.tree().octants() as u64,
            blocks_by_scale: occupancy.arrays().map(|n| n as u64),
            memory_bytes: occupancy.bytes() as u64,
        };
        Self {
            id: submap.id(),
            file: name.to_string(),
            bytes: written.bytes,
            crc32: written.crc32,
            t_map_submap: piece.t_map_submap,
            travelled: submap.travelled(),
            tsdf: (!tsdf.is_empty()).then(of_tsdf),
            occupancy: (!occupancy.is_empty()).then(of_occupancy),
            scans: submap.scans().iter().map(|s| ScanEntry { node: s.node, t_submap_lidar: s.t_submap_lidar }).collect(),
        }
    }

    /// What the entry says about its file.
    pub(super) fn expected(&self) -> Expected {
        Expected { id: self.id, bytes: self.bytes, crc32: self.crc32 }
    }

    /// The submap with `fields`.
    pub(super) fn submap(&self, fields: Fields, voxel_size: f32) -> Submap {
        let scans = self.scans.iter().map(|s| SubmapScan { node: s.node, t_submap_lidar: s.t_submap_lidar }).collect();
        let submap = Submap::new(self.id, voxel_size, self.t_map_submap).with_scans(scans, self.travelled);
        submap.with_fields(fields.tsdf, fields.occupancy)
    }
}

/// Refuses a submap whose numbers the manifest of the map in `dir` cannot hold.
pub(super) fn check_storable(piece: &Piece<'_>, dir: &Path) -> Result<()> {
    let submap = piece.submap;
    let unstorable = |what: String| Error::unwritable(dir, format!("submap {}: {what}", submap.id()));
    pose_as_numbers::check(&piece.t_map_submap).map_err(|e| unstorable(format!("its root pose {e}")))?;
    for scan in submap.scans() {
        pose_as_numbers::check(&scan.t_submap_lidar).map_err(|e| unstorable(format!("the pose of node {} {e}", scan.node)))?;
    }
    if submap.travelled().is_finite() { Ok(()) } else { Err(unstorable(format!("its travelled distance is {}", submap.travelled()))) }
}

/// Poses as `[x, y, z, qx, qy, qz, qw]`, the order of TUM trajectories, every bit kept.
mod pose_as_numbers {
    use nalgebra::{Quaternion, Translation3, UnitQuaternion};
    use serde::{Deserialize, Deserializer, Serialize, Serializer, de};
    use voxelastic::Pose;

    /// How far a quaternion's norm may be from 1.
    const TOLERANCE: f64 = 1e-3;

    pub fn check(pose: &Pose) -> Result<(), String> {
        let norm = pose.rotation.norm();
        if !numbers(pose).iter().all(|n| n.is_finite()) {
            Err("is not finite".to_owned())
        } else if (norm - 1.0).abs() > TOLERANCE {
            Err(format!("has a quaternion of norm {norm} instead of 1"))
        } else {
            Ok(())
        }
    }

    fn numbers(pose: &Pose) -> [f64; 7] {
        let (t, q) = (&pose.translation.vector, &pose.rotation.coords);
        [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
    }

    pub fn serialize<S: Serializer>(pose: &Pose, serializer: S) -> Result<S::Ok, S::Error> {
        numbers(pose).serialize(serializer)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Pose, D::Error> {
        let [x, y, z, qx, qy, qz, qw] = <[f64; 7]>::deserialize(deserializer)?;
        // Normalising again would change bits.
        let pose = Pose::from_parts(Translation3::new(x, y, z), UnitQuaternion::new_unchecked(Quaternion::new(qw, qx, qy, qz)));
        check(&pose).map_err(|e| de::Error::custom(format!("a pose {e}")))?;
        Ok(pose)
    }
}
