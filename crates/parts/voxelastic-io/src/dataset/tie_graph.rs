//! Matching the nodes of a pose graph to clouds.

use super::matching::Clouds;
use super::pose_file::PoseFile;
use crate::{Error, OpenOptions, PoseGraph, Result};
use voxelastic::event::NodeId;

/// A pose graph with its file.
pub(super) type NamedGraph = (PoseFile, PoseGraph);

/// The node of every cloud, and the graph, if it fits.
pub(super) struct Nodes {
    pub(super) nodes: Vec<NodeId>,
    pub(super) graph: Option<NamedGraph>,
    /// Why the graph is not used.
    pub(super) note: Option<String>,
}

/// Gives every cloud its node: as the graph numbers them, else the numbers in the clouds' names, else their order. A graph without any of the
/// clouds' nodes is not used.
///
/// # Errors
/// [`Error::Dataset`] for such a graph if `options` are strict.
pub(super) fn tie(clouds: Clouds<'_>, graph: Option<NamedGraph>, options: &OpenOptions) -> Result<Nodes> {
    let count = clouds.files.len();
    let numbers = clouds.numbers();
    let mut note = None;
    if let Some((file, graph)) = graph {
        let ids = graph.sorted_ids();
        if ids.len() == count {
            return Ok(Nodes { nodes: ids, graph: Some((file, graph)), note });
        }
        if let Some(numbers) = numbers.clone().filter(|n| n.iter().any(|n| ids.binary_search(n).is_ok())) {
            return Ok(Nodes { nodes: numbers, graph: Some((file, graph)), note });
        }
        let problem = format!("its {} nodes cannot be matched to the {count} clouds", ids.len());
        if options.strict {
            return Err(Error::dataset(&file.path, problem, "number the clouds like the nodes, or do without --strict"));
        }
        note = Some(format!("{}: {problem}: its edges are not used", file.name()));
    }
    Ok(Nodes { nodes: numbers.unwrap_or_else(|| (0..count as NodeId).collect()), graph: None, note })
}
