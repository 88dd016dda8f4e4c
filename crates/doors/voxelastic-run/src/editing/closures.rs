//! The closures of a map, and how far the poses are from them.

use super::graph;
use super::list::Edit;
use super::parse::parse;
use crate::error::Result;
use crate::map_files;
use serde::Serialize;
use std::collections::BTreeMap;
use voxelastic::Pose;
use voxelastic::event::{Edge, NodeId};
use voxelastic::geometry::PoseExt;
use voxelastic_io::store::MapStore;

/// A closure of a map.
#[derive(Clone, Debug, Serialize)]
pub struct ListedClosure {
    /// Its scans.
    pub scans: [NodeId; 2],
    /// How far the second is, by the poses of the map, from where the closure has it in the frame of the first, metres.
    pub off_m: f64,
}

/// The edits that a map is shown with. Somebody may be editing it.
///
/// # Errors
/// A map that is none, and a list that is not that of the map.
pub fn edits(store: &MapStore) -> Result<Vec<Edit>> {
    parse(&store.edits()?, &store.dir().join("edits.toml").display().to_string())
}

/// The closures of a map as it is shown: those of its run, of its sessions and of its edits, the one that the poses contradict most first.
///
/// # Errors
/// As for [`edits`], and a log of the run that is damaged.
pub fn closures(store: &MapStore) -> Result<Vec<ListedClosure>> {
    let poses = graph::poses(&store.manifest().submaps);
    Ok(listed(loops_of(store)?, &edits(store)?, &poses))
}

/// The loop edges of the run of a map and of its sessions.
pub(super) fn loops_of(store: &MapStore) -> Result<Vec<Edge>> {
    let manifest = store.manifest();
    Ok(graph::loops(&map_files::read_run_log(store)?.unwrap_or_default(), &manifest.all_sessions(), &graph::poses(&manifest.submaps)))
}

/// What edits make of loop edges, the one that the poses contradict most first.
pub(super) fn listed<'a>(mut all: Vec<Edge>, edits: impl IntoIterator<Item = &'a Edit>, poses: &BTreeMap<NodeId, Pose>) -> Vec<ListedClosure> {
    for edit in edits {
        match edit {
            Edit::Closure { edges, .. } => all.extend(edges.iter().cloned()),
            Edit::RemoveClosure { scans: [a, b] } => all.retain(|edge| ![[*a, *b], [*b, *a]].contains(&[edge.from, edge.to])),
            _ => {}
        }
    }
    let row = |edge: &Edge| {
        let now = poses.get(&edge.from)?.inv_mul(poses.get(&edge.to)?);
        Some(ListedClosure { scans: [edge.from, edge.to], off_m: now.translation_distance(&edge.t_from_to) })
    };
    let mut rows: Vec<ListedClosure> = all.iter().filter_map(row).collect();
    rows.sort_by(|a, b| b.off_m.total_cmp(&a.off_m).then(a.scans.cmp(&b.scans)));
    rows
}
