//! Making a submap anew from its scans: a rigid submap cannot follow corrections between its own nodes, its scans can.

use super::{Front, Mapper};
use crate::Cloud;
use crate::atlas::{Submap, SubmapId};
use crate::event::NodeId;
use crate::integrate::Known;

/// Where the clouds of scans already mapped can be had again.
pub trait ScanSource {
    /// The cloud taken at `node`.
    ///
    /// # Errors
    /// Whatever keeps it from being read; the submap then stays as it is.
    fn cloud(&mut self, node: NodeId) -> Result<Cloud, Box<dyn std::error::Error + Send + Sync>>;
}

/// What a rebuild did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RebuildReport {
    /// Scans integrated.
    pub scans: usize,
    /// Bytes that the submap's fields held before.
    pub bytes_before: usize,
    /// Bytes that they hold now.
    pub bytes_after: usize,
}

/// Why a submap was not rebuilt. It is as it was before.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RebuildError {
    /// There is no such submap.
    #[error("there is no submap {submap}")]
    NoSuchSubmap {
        /// Its id.
        submap: SubmapId,
    },
    /// A scan could not be had again.
    #[error("submap {submap} cannot be rebuilt: the scan of node {node} cannot be read")]
    Scan {
        /// The submap.
        submap: SubmapId,
        /// The scan's node.
        node: NodeId,
        /// Why.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
}

impl Mapper {
    /// Makes submap `id` anew from its scans at the current poses of their nodes; fusions under way are finished first. Its doubts are
    /// open again until [`finish`](Self::finish).
    ///
    /// # Errors
    /// [`RebuildError`]; the submap is as it was before.
    pub fn rebuild(&mut self, id: SubmapId, source: &mut dyn ScanSource) -> Result<RebuildReport, RebuildError> {
        self.finish_fusions();
        self.is_settled = false;
        let old = self.atlas.submap(id).ok_or(RebuildError::NoSuchSubmap { submap: id })?;
        let root = old.root_node().and_then(|root| self.graph.pose(root)).copied().unwrap_or(old.t_map_submap);
        let mut new = Submap { revision: old.revision + 1, ..Submap::new(id, root) };
        let mut scans = 0;
        for scan in &old.scans {
            let node = scan.node;
            let cloud = source.cloud(node).map_err(|source| RebuildError::Scan { submap: id, node, source })?;
            let t_submap_lidar = self.graph.pose(node).map_or(scan.t_submap_lidar, |pose| root.inv_mul(pose));
            new.place_scan(node, t_submap_lidar);
            let front = match &mut self.front {
                Some(front) => front,
                None => match Front::open(&self.settings, self.known.as_ref(), &cloud) {
                    Ok(front) => self.front.insert(front),
                    Err(error) => return Err(RebuildError::Scan { submap: id, node, source: Box::new(error) }),
                },
            };
            front.prepare(&cloud);
            front.finish(&cloud);
            if !front.scan().beams.is_empty() {
                self.integrators.integrate(&mut new, &t_submap_lidar, front, &self.settings, &Known::default());
                scans += 1;
            }
        }
        new.tsdf.rest_all();
        let report = RebuildReport { scans, bytes_before: old.bytes(), bytes_after: new.bytes() };
        if let Some(place) = self.atlas.submap_mut(id) {
            *place = new;
        }
        self.counts.rebuilds += 1;
        Ok(report)
    }
}
