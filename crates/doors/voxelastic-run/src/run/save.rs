//! The map of a run is saved: as it is, or as a session of a map that is there.

use super::{Kept, MappingRun};
use crate::corrections::ClosureSummary;
use crate::joining::{self, Frame, Outcome, SessionSummary, Sessions};
use crate::keep::Target;
use crate::warning::Code;
use crate::{Error, Result};
use std::path::Path;
use voxelastic_io::store::SaveReport;
use voxelastic_report::RunLog;

/// What was saved of a session that was to be added to a map.
#[derive(Debug, Default)]
pub struct SavedSession {
    /// Files written.
    pub report: SaveReport,
    /// Where it lies in the map that it was added to; none if it was not.
    pub added: Option<SessionSummary>,
    /// Whether nothing was saved, but the run is kept to be gone on with.
    pub is_kept: bool,
}

impl MappingRun {
    /// Saves the map as it is now; if the file system refuses, as the [`SaveOptions`](crate::keep::SaveOptions) say.
    ///
    /// # Errors
    /// When no disk takes it, or the run has none.
    pub fn save(&mut self) -> Result<SaveReport> {
        let details = self.details();
        let Self { mapping, kept, warnings, .. } = self;
        let Kept { target, .. } = kept.as_mut().ok_or_else(|| Error::new("nothing is saved here: this run has no map on disk", ""))?;
        target.save(mapping, &details, warnings)
    }

    /// Adds the map as a session to the map that is there, or saves it as one of its own, at the first free name like `apart`, if it was interrupted or its place is
    /// not found. `run` is what the session is known by, `input` what it was made of; `align` about where it lies.
    ///
    /// # Errors
    /// When the map that is there cannot be read, or no disk takes the session.
    pub fn save_session(&mut self, input: &Path, run: String, align: Option<Frame>, interrupted: bool, apart: &Path) -> Result<SavedSession> {
        let details = self.details();
        let (origin, has_frame) = (self.origin(), self.is_raw() != Some(true));
        let Self { mapping, kept, warnings, .. } = self;
        let Kept { target, .. } = kept.as_mut().ok_or_else(|| Error::new("nothing is saved here: this run has no map on disk", ""))?;
        let map = target.path().to_owned();
        let why = if interrupted {
            if target.has_checkpoint() {
                let text = format!("interrupted: {} is as it was before; the same command goes on with the session and adds it", map.display());
                warnings.add(Code::NotJoined, text, "");
                return Ok(SavedSession { is_kept: true, ..SavedSession::default() });
            }
            "it was interrupted".to_owned()
        } else {
            let atlas = mapping.atlas();
            let sessions = Sessions { atlas, origin, entries: vec![joining::new_session(atlas, input, run)], has_frame };
            let store = target.store()?;
            match mapping.pool().install(|| joining::place(store, sessions, align, warnings))? {
                Outcome::Joined(addition, summary) => {
                    target.set_addition(addition);
                    let report = target.save(mapping, &details, warnings)?;
                    let is_there = !target.is_elsewhere();
                    if is_there {
                        joining::log(&map, &summary, warnings);
                    }
                    return Ok(SavedSession { report, added: is_there.then_some(summary), is_kept: false });
                }
                Outcome::Apart(why) => why,
            }
        };
        let report = target.save_apart(mapping, &details, apart, warnings)?;
        let (map, apart) = (map.display(), target.path().display());
        let text = format!("the session is not added to {map}, which is as it was before: {why}; it is saved as {apart}");
        warnings.add(Code::NotJoined, text, format!("`voxelastic merge {apart} --into {map} --align X,Y,Z,YAW` adds it where you say it lies"));
        Ok(SavedSession { report, added: None, is_kept: false })
    }

    /// The log of the run so far. The caller adds what it knows: the input, the time in all, whether it was interrupted.
    pub fn log(&self) -> RunLog {
        RunLog {
            scans_skipped: self.skipped(),
            registrations: self.odometry().map(|odometry| odometry.registrations).unwrap_or_default(),
            closures: self.closures().as_ref().map(ClosureSummary::for_report).unwrap_or_default(),
            warnings: self.warnings.all().to_vec(),
            ..self.mapping.log()
        }
    }

    /// Stores the log with the map.
    pub fn save_log(&mut self, log: &RunLog) {
        if let Some(kept) = &mut self.kept {
            kept.target.log(log, &mut self.warnings);
        }
    }

    /// Keeps the log of all but the last scans in a file beside the map, for runs that go on for hours.
    pub fn keep_log_on_disk(&mut self) {
        if let Some(folder) = self.target().map(Target::path).map(Path::to_owned) {
            self.mapping.keep_log_in(&folder, &mut self.warnings);
        }
    }
}
