//! The scans of a recording that are nodes of a pose graph.

use crate::scan_list::{ScanEdges, ScanEntry};
use crate::{Error, OpenOptions, Result, g2o, poses};
use std::path::{Path, PathBuf};

/// The nodes of a graph with the times of a trajectory that has one pose per node, in the order of time.
///
/// # Errors
/// [`Error::Dataset`] if the numbers of nodes and times differ; those of reading the two files.
pub(super) fn read_nodes(graph: &Path, poses_path: &Path, options: &OpenOptions) -> Result<(Vec<ScanEntry>, ScanEdges)> {
    let (graph_read, trajectory) = (g2o::read(graph)?, poses::read(poses_path)?);
    let ids = graph_read.sorted_ids();
    let times = trajectory.times.unwrap_or_default();
    if ids.len() != times.len() {
        let problem = format!("{} nodes, but {} poses in {}", ids.len(), times.len(), poses_path.display());
        return Err(Error::dataset(graph, problem, "give a trajectory with one pose per node, in their order"));
    }
    let entry = |k: usize| ScanEntry { path: PathBuf::new(), index: k, node: ids[k], time: times[k], t_map_lidar: trajectory.poses[k], sensor: 0 };
    let entries: Vec<ScanEntry> = (0..ids.len()).map(entry).collect();
    let edges = ScanEdges::of(Some(&graph_read), &entries, options.t_base_lidar.as_ref());
    Ok((entries, edges))
}
