//! What a map is made of: settings, sensor, and the table of submaps with where they lie.

use super::piece::{MapDetails, Piece, ScanEntry, corrected_entries, scan_entries};
use super::pose_as_numbers;
use crate::store::additions::sessions::SessionEntry;
use crate::store::files::SubmapName;
use crate::store::sections::submap_file::{Expected, Fields, Written};
use serde::{Deserialize, Serialize};
use voxelastic::atlas::{Submap, SubmapId, SubmapScan};
use voxelastic::event::NodeId;
use voxelastic::octree::SCALES;
use voxelastic::{Pose, Settings};

/// The content of a map's `manifest.json`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Manifest {
    /// How the map was made.
    pub details: MapDetails,
    /// The sessions that it was made of, by number; none for a map that is one session. [`all_sessions`](Self::all_sessions) has that one, too.
    pub sessions: Vec<SessionEntry>,
    /// The submaps, ordered by id.
    pub submaps: Vec<SubmapEntry>,
    /// Which edits the map is shown with; none for a map without.
    pub edits: Option<EditsMark>,
}

/// Which edits of a list a map is shown with: the first bytes of `edits.toml`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct EditsMark {
    /// Number of the edits.
    pub count: usize,
    /// Bytes of the list that they take. What follows in the file is of an edit that was never complete.
    pub bytes: u64,
    /// CRC-32 of these bytes.
    pub crc32: u32,
}

impl EditsMark {
    /// Of a list of so many edits.
    pub(crate) fn of(list: &str, count: usize) -> Self {
        Self { count, bytes: list.len() as u64, crc32: crc32fast::hash(list.as_bytes()) }
    }
}

impl Manifest {
    /// The sessions of the map, by number. A map without a list of them is one session.
    pub fn all_sessions(&self) -> Vec<SessionEntry> {
        if !self.sessions.is_empty() || self.submaps.is_empty() {
            return self.sessions.clone();
        }
        let of = |end: Option<&SubmapEntry>| end.map_or(0, |entry| entry.id);
        vec![SessionEntry {
            number: 1,
            input: None,
            added: None,
            scans: self.submaps.iter().map(|entry| entry.scans.len()).sum(),
            first_submap: of(self.submaps.first()),
            last_submap: of(self.submaps.last()),
            node_offset: 0,
            t_map_session: None,
            loop_edges: Vec::new(),
            run: None,
        }]
    }

    /// The first number that no node has.
    pub fn next_node(&self) -> NodeId {
        self.submaps.iter().flat_map(|entry| &entry.scans).map(|scan| scan.node).max().map_or(0, |last| last.saturating_add(1))
    }

    /// Edge of the finest voxel as the settings in the manifest have it, metres; the default if they do not.
    ///
    /// # Errors
    /// In words, when they have a number that is no voxel size: with another, every coordinate of the map would be wrong. Other words belong to whoever
    /// stored them.
    pub(crate) fn voxel_size(&self) -> Result<f32, String> {
        let (key, mut settings) = ("voxel_size", Settings::default());
        if let Some(value) = self.details.settings.get(key)
            && let Err(problem) = settings.set(key, value)
            && value.trim().parse::<f64>().is_ok()
        {
            return Err(problem.to_string());
        }
        Ok(settings.voxel_size)
    }
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
    /// Where the last correction put these scans; empty if they are as integrated.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub corrected: Vec<ScanEntry>,
}

/// Size of a submap's TSDF.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TsdfSummary {
    /// Blocks integrated at scales 0 to 3.
    pub blocks_by_scale: [u64; SCALES],
}

/// Size of a submap's occupancy field.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct OccupancySummary {
    /// Octants of the tree.
    pub octants: u64,
    /// Blocks that hold voxels at scales 0 to 3.
    pub blocks_by_scale: [u64; SCALES],
}

impl SubmapEntry {
    /// The entry of a submap whose file is `name`.
    pub(in crate::store) fn new(piece: &Piece<'_>, name: SubmapName, written: Written) -> Self {
        let submap = piece.submap;
        let (tsdf, occupancy) = (submap.tsdf(), submap.occupancy());
        let of_tsdf = || TsdfSummary { blocks_by_scale: tsdf.blocks_by_scale().map(|n| n as u64) };
        let of_occupancy = || OccupancySummary { octants: occupancy.tree().octants() as u64, blocks_by_scale: occupancy.arrays().map(|n| n as u64) };
        Self {
            id: submap.id(),
            file: name.to_string(),
            bytes: written.bytes,
            crc32: written.crc32,
            t_map_submap: piece.t_map_submap,
            travelled: submap.travelled(),
            tsdf: (!tsdf.is_empty()).then(of_tsdf),
            occupancy: (!occupancy.is_empty()).then(of_occupancy),
            scans: scan_entries(submap),
            corrected: corrected_entries(submap),
        }
    }

    /// What the entry says about its file.
    pub(crate) fn expected(&self) -> Expected {
        Expected { id: self.id, bytes: self.bytes, crc32: self.crc32 }
    }

    /// The submap with `fields`.
    pub(crate) fn submap(&self, fields: Fields, voxel_size: f32) -> Submap {
        let scans = self.scans.iter().map(|s| SubmapScan { node: s.node, t_submap_lidar: s.t_submap_lidar }).collect();
        let submap = Submap::new(self.id, voxel_size, self.t_map_submap).with_scans(scans, self.travelled);
        let submap = submap.with_corrected(self.corrected.iter().map(|s| s.t_submap_lidar).collect());
        submap.with_fields(fields.tsdf, fields.occupancy)
    }
}
