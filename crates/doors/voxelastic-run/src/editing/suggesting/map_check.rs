//! What is least consistent in a map on disk.

use super::suggestion::Suggestion;
use crate::editing::closures::{edits, listed, loops_of};
use crate::editing::editor::replay;
use crate::editing::graph::poses;
use crate::editing::state::State;
use crate::error::Result;
use crate::map_files;
use serde::Serialize;
use std::path::Path;

/// What was looked at, and what is not consistent.
#[derive(Clone, Debug, Serialize)]
pub struct MapCheck {
    /// Always `map`.
    pub kind: &'static str,
    /// What the map is made of.
    pub submaps: usize,
    /// Scans in it.
    pub scans: usize,
    /// Closures of its run, its sessions and its edits.
    pub closures: usize,
    /// Edits that it is shown with.
    pub edits: usize,
    /// What is least consistent, first.
    pub suggestions: Vec<Suggestion>,
}

impl MapCheck {
    /// Looks at a map as it is shown; `tried` is called after each edit that was tried. Takes no lock, and changes nothing. To be called in a pool.
    ///
    /// # Errors
    /// A map that is none or is damaged, and edits that cannot be done again.
    pub fn of(map: &Path, tried: &mut (dyn FnMut() + Send)) -> Result<Self> {
        let store = map_files::open(map)?;
        let (base, mut edits) = (store.before_edits()?, edits(&store)?);
        let mut state = State::of(&base)?;
        replay(&mut state, map, &mut edits, |_, _, _| ())?;
        let closures = listed(loops_of(&base)?, &edits, &poses(&state.entries));
        let suggestions = super::suggestions(&mut state, &closures, tried)?;
        let scans = state.entries.iter().map(|entry| entry.scans.len()).sum();
        Ok(Self { kind: "map", submaps: state.entries.len(), scans, closures: closures.len(), edits: edits.len(), suggestions })
    }

    /// For people, on a page: a list of edits, with what they are for in comments.
    pub fn page(&self) -> String {
        let mut page = format!("# {} submaps, {} scans, {} closures, {} edits\n", self.submaps, self.scans, self.closures, self.edits);
        if self.suggestions.is_empty() {
            page += "# nothing is inconsistent\n";
        }
        for (k, one) in self.suggestions.iter().enumerate() {
            let [x, y, z] = one.at;
            page += &format!("\n# {}. {}\n# at {x:.1}, {y:.1}, {z:.1}", k + 1, one.text);
            if let Some([before, after]) = one.places_agree {
                page += &format!("; with this edit {after} places on surfaces agree, and {before} without");
            }
            page += &format!("\n{}\n", one.edit);
        }
        page
    }
}
