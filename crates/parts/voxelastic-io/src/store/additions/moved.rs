//! A saved map whose submaps are moved: their files stay, the manifest is another.

use crate::store::description::manifest::SubmapEntry;
use crate::store::description::piece::MapDetails;
use crate::store::description::pose_as_numbers;
use crate::store::files;
use crate::store::writer::{MapWriter, RunLogFate, SaveReport};
use crate::{Error, Result};

impl MapWriter {
    /// Puts each submap where `moved` has it, which changes poses of entries only, and stores `details` with the map. No submap file is read or written. When this
    /// returns, the map is durable; when it fails or the process dies, the map is the one before.
    ///
    /// # Errors
    /// [`Error::Unwritable`] when a pose is not finite; [`Error::Io`] when the file system refuses.
    pub fn move_submaps(&mut self, mut moved: impl FnMut(&mut SubmapEntry), details: &MapDetails) -> Result<SaveReport> {
        let dir = self.store().dir().to_owned();
        let manifest = self.store().manifest();
        let sessions = manifest.sessions.clone();
        let mut entries = Vec::with_capacity(manifest.submaps.len());
        for entry in &manifest.submaps {
            let mut entry = entry.clone();
            moved(&mut entry);
            let poses = entry.corrected.iter().map(|scan| &scan.t_submap_lidar).chain([&entry.t_map_submap]);
            for pose in poses {
                pose_as_numbers::check(pose).map_err(|e| Error::unwritable(&dir, format!("submap {}: a pose {e}", entry.id)))?;
            }
            entries.push((entry, false));
        }
        let report = self.commit_sessions(entries, details, sessions, RunLogFate::Kept, |_| Ok(()))?;
        files::sync_dir(&dir)?;
        Ok(report)
    }
}
