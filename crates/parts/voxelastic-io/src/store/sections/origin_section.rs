//! The origin section of a submap file: where the submap lies and what it was made from, as JSON. The manifest is rebuilt from it when it is lost.
//!
//! The root pose is the one of the time at which the file was written: a correction of poses rewrites the manifest only.

use super::frames::Section;
use crate::Result;
use crate::store::additions::sessions::SessionEntry;
use crate::store::description::piece::{MapDetails, Piece, ScanEntry, scan_entries};
use crate::store::description::pose_as_numbers;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::{self, Write};
use voxelastic::Pose;
use voxelastic::atlas::{Submap, SubmapId, SubmapScan};
use voxelastic::field::occupancy::OccupancyField;
use voxelastic::field::tsdf::TsdfField;
use xxhash_rust::xxh3::xxh3_64;

/// Where a submap came from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Origin {
    generator: String,
    settings: BTreeMap<String, String>,
    sensor: BTreeMap<String, String>,
    /// Root pose when the file was written: the submap frame in the map frame.
    #[serde(with = "pose_as_numbers")]
    pub t_map_submap: Pose,
    /// Path length from the root pose to the last scan, metres.
    pub travelled: f64,
    /// The scans in the order in which they were integrated.
    pub scans: Vec<ScanEntry>,
    /// The session that it was added to a map with, but for its time and loop edges; absent for those that the map began with.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub session: Option<SessionEntry>,
}

impl Origin {
    /// How the map was made that the submap was saved in.
    pub fn details(&self) -> MapDetails {
        let Self { generator, settings, sensor, .. } = self.clone();
        MapDetails { generator, settings, sensor }
    }

    /// The submap with these fields.
    pub fn submap(&self, id: SubmapId, voxel_size: f32, tsdf: TsdfField, occupancy: OccupancyField) -> Submap {
        let scans = self.scans.iter().map(|s| SubmapScan { node: s.node, t_submap_lidar: s.t_submap_lidar }).collect();
        Submap::new(id, voxel_size, self.t_map_submap).with_scans(scans, self.travelled).with_fields(tsdf, occupancy)
    }
}

/// A hash of the part that belongs to the submap: the root pose belongs to the manifest, and the details to the map.
pub(crate) fn digest(submap: &Submap) -> u64 {
    let mut bytes = submap.travelled().to_le_bytes().to_vec();
    for scan in submap.scans() {
        let (t, q) = (&scan.t_submap_lidar.translation.vector, &scan.t_submap_lidar.rotation.coords);
        bytes.extend(scan.node.to_le_bytes());
        [t.x, t.y, t.z, q.x, q.y, q.z, q.w].iter().for_each(|number| bytes.extend(number.to_le_bytes()));
    }
    xxh3_64(&bytes)
}

/// Writes the section.
pub(crate) fn write(piece: &Piece<'_>, details: &MapDetails, out: &mut impl Write) -> io::Result<()> {
    let MapDetails { generator, settings, sensor } = details.clone();
    let (t_map_submap, travelled, scans) = (piece.t_map_submap, piece.submap.travelled(), scan_entries(piece.submap));
    // Without the time: the same scans make the same file.
    let session = piece.session.map(|session| SessionEntry { added: None, loop_edges: Vec::new(), ..session.clone() });
    let origin = Origin { generator, settings, sensor, t_map_submap, travelled, scans, session };
    out.write_all(&serde_json::to_vec(&origin)?)
}

/// Reads a section whose checksum is right.
pub(crate) fn read(section: &Section<'_>) -> Result<Origin> {
    serde_json::from_slice(section.bytes).map_err(|e| section.damaged(e.column().saturating_sub(1), e.to_string()))
}
