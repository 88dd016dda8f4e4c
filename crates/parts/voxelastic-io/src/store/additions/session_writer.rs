//! Adding sessions to a saved map, and taking them out again.

use super::sessions::SessionEntry;
use crate::store::description::manifest::SubmapEntry;
use crate::store::description::piece::{Piece, check_storable};
use crate::store::files;
use crate::store::writer::{MapWriter, RunLogFate, SaveReport, names, remove_unfinished};
use crate::{Error, Result};
use rayon::prelude::*;
use voxelastic::atlas::{Atlas, Submap};

impl MapWriter {
    /// Adds the submaps of `atlas`, each as `placed` makes it, to the map, whose sessions are then these. Nothing of the submaps that are there is read or changed.
    /// When this returns, the map is durable; when it fails or the process dies, the map is the one before.
    ///
    /// # Errors
    /// [`Error::Unwritable`] when a submap has the number of one that is there, or a pose is not finite; [`Error::Io`] when the file system refuses.
    pub fn add_session(&mut self, atlas: &Atlas, placed: impl Fn(&Submap) -> Submap + Sync, sessions: Vec<SessionEntry>) -> Result<SaveReport> {
        let dir = self.store().dir().to_owned();
        let details = self.store().manifest().details.clone();
        let write = |submap: &Submap| {
            // One after the other on each thread, so that no more copies are in memory than there are threads.
            let moved = placed(submap);
            if self.store().entry(moved.id()).is_some() {
                return Err(Error::unwritable(&dir, format!("it has a submap {} already", moved.id())));
            }
            let session = sessions.iter().find(|session| session.has(moved.id()) && session.t_map_session.is_some());
            let piece = Piece { submap: &moved, t_map_submap: moved.t_map_submap(), session };
            check_storable(&piece, &dir)?;
            self.save_piece(&piece, &details, None).map(|(entry, _)| entry)
        };
        let written: Vec<Result<SubmapEntry>> = atlas.submaps().par_iter().map(write).collect();
        let added = written.into_iter().collect::<Result<Vec<_>>>();
        let saved = added.and_then(|added| {
            files::sync_dir(&dir)?;
            let mut entries: Vec<(SubmapEntry, bool)> = self.store().manifest().submaps.iter().map(|entry| (entry.clone(), false)).collect();
            entries.extend(added.into_iter().map(|entry| (entry, true)));
            entries.sort_by_key(|(entry, _)| entry.id);
            self.replace(entries, sessions, true)
        });
        saved.inspect_err(|_| remove_unfinished(&dir))
    }

    /// Takes the session with this number, and its submaps, out of the map. The others stay as they are: a map to which the last session was added is what it was
    /// before, bit for bit.
    ///
    /// # Errors
    /// [`Error::NoSuchSession`]; [`Error::Unwritable`] when nothing would be left; [`Error::Io`] when the file system refuses.
    pub fn remove_session(&mut self, number: u32) -> Result<SaveReport> {
        let manifest = self.store().manifest();
        let sessions = manifest.all_sessions();
        let Some(removed) = sessions.iter().find(|session| session.number == number) else {
            let known = sessions.iter().map(|session| session.number).collect();
            return Err(Error::NoSuchSession { path: self.store().dir().to_owned(), number, known });
        };
        let left: Vec<(SubmapEntry, bool)> =
            manifest.submaps.iter().filter(|entry| !removed.has(entry.id)).map(|entry| (entry.clone(), false)).collect();
        if left.is_empty() {
            return Err(Error::unwritable(self.store().dir(), format!("session {number} is all of it")));
        }
        let keeps_log = sessions.first().is_some_and(|first| first.number != number);
        let sessions = sessions.iter().filter(|session| session.number != number).cloned().collect();
        self.replace(left, sessions, keeps_log)
    }

    /// Replaces the manifest by one of these submaps and sessions, and removes what it no longer names. The log of the run is that of the first session.
    fn replace(&mut self, entries: Vec<(SubmapEntry, bool)>, sessions: Vec<SessionEntry>, keeps_log: bool) -> Result<SaveReport> {
        let dir = self.store().dir().to_owned();
        let details = self.store().manifest().details.clone();
        let log = if keeps_log { RunLogFate::Kept } else { RunLogFate::Removed };
        let mut report = self.commit_sessions(entries, &details, listed(sessions), log, |_| Ok(()))?;
        files::sync_dir(&dir)?;
        report.removed = files::remove_others(&dir, |name| names(self.store(), name))?;
        Ok(report)
    }
}

/// The list as a manifest has it: none if it says no more than that the map is one session.
fn listed(sessions: Vec<SessionEntry>) -> Vec<SessionEntry> {
    match &sessions[..] {
        [only] if only.number == 1 && only.t_map_session.is_none() => Vec::new(),
        _ => sessions,
    }
}
