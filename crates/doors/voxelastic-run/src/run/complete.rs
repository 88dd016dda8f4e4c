//! The end of a run: fusions, and submaps that are made again from their scans.

use super::MappingRun;
use crate::corrections::Rebuild;
use crate::error::one_line;
use crate::warning::Code;
use voxelastic::atlas::SubmapId;
use voxelastic::mapper::ScanSource;

impl MappingRun {
    /// Completes the map: fusions, submaps that are to be rebuilt from their scans, conflicts between submaps. `next` is told before each submap how many are
    /// rebuilt and how many are to be, and says whether to go on. Returns the number of rebuilt submaps; one that cannot be rebuilt is left unchanged.
    pub fn complete(&mut self, clouds: &mut (dyn ScanSource + Send), mut next: impl FnMut(usize, usize) -> bool) -> usize {
        self.mapping.finish_fusions();
        self.say_what_was_corrected();
        let deformed = self.mapping.mapper().deformed();
        let rebuild = self.corrections.rebuild;
        if !deformed.is_empty() {
            let most = deformed.iter().map(|d| d.distance).fold(0.0, f64::max);
            let text = format!("corrections moved scans of {} submaps relative to each other, by up to {most:.2} m", deformed.len());
            let remedy = if rebuild == Rebuild::None { "; --rebuild-deformed rebuilds them" } else { "" };
            tracing::info!("{text}{remedy}");
        }
        let submaps: Vec<SubmapId> = match rebuild {
            Rebuild::All => self.mapping.atlas().submaps().iter().map(|s| s.id()).collect(),
            Rebuild::Deformed => deformed.iter().map(|d| d.submap).collect(),
            Rebuild::None => Vec::new(),
        };
        let mut rebuilt = 0;
        for (k, id) in submaps.iter().enumerate() {
            if !next(k, submaps.len()) {
                break;
            }
            match self.mapping.rebuild(*id, clouds) {
                Ok(_) => rebuilt += 1,
                Err(error) => self.warnings.add(Code::NotRebuilt, format!("submap {id} is not rebuilt: {}", one_line(&error)), ""),
            }
        }
        self.mapping.finish();
        rebuilt
    }

    /// Logs counts of loop edges, corrections and fusions, if there were any.
    fn say_what_was_corrected(&mut self) {
        let (counts, graph) = (self.mapping.mapper().elastic_counts(), self.mapping.mapper().graph_counts());
        if graph.loop_edges > 0 || counts.pose_updates > 0 {
            tracing::info!(
                "{} loop edges ({} not confirmed by the poses), {} pose updates, {} submaps moved, {} fusions",
                graph.loop_edges,
                graph.open_loops,
                counts.pose_updates,
                counts.submap_moves,
                counts.fusions
            );
            if counts.size_limited_groups > 0 {
                let why = "the merged submap would be larger than lambda_odom + lambda_cluster";
                tracing::info!("{} groups of submaps joined by loop edges are not merged: {why}", counts.size_limited_groups);
            }
        }
        if counts.unknown_poses + graph.waiting_edges > 0 {
            let text = format!("{} corrected poses and {} edges refer to nodes without a scan", counts.unknown_poses, graph.waiting_edges);
            self.warnings.add(Code::UnknownNodes, text, "");
        }
    }
}
