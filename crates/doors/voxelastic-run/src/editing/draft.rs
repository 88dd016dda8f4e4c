//! A map that is edited and looked at before it is written: every edit is tried first, then taken or dropped, and nothing is on the disk until it is saved.

use super::closures::{ListedClosure, edits, listed, loops_of};
use super::editor::{Editor, locked, replay, undo_all};
use super::graph;
use super::list::{Between, Edit};
use super::pair_fit::{PairFit, fit};
use super::state::{Done, State};
use super::suggesting::{Suggestion, suggestions};
use crate::error::{Error, Result};
use crate::map_files;
use serde::Serialize;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use voxelastic::Pose;
use voxelastic::atlas::{Submap, SubmapId};
use voxelastic::event::{Edge, NodeId};
use voxelastic::geometry::PoseExt;
use voxelastic_io::Origin;
use voxelastic_io::store::{MapEditor, SubmapEntry};

/// What moved less has not moved, metres.
const LEAST_MOVED: f64 = 1e-4;

/// A map with edits in memory.
pub struct Draft {
    dir: PathBuf,
    /// None where somebody else has the map.
    editor: Option<Editor>,
    read_only: Option<String>,
    /// Edits that the map has and that cannot be taken back here, because somebody else has it.
    fixed: Vec<Edit>,
    first: State,
    steps: Vec<Step>,
    undone: Vec<Step>,
    trial: Option<Step>,
    /// As it is on the disk.
    saved: State,
    shows_saved: bool,
    /// Of the run and of sessions, before all edits.
    loops: Vec<Edge>,
}

/// An edit with the map that it makes.
struct Step {
    edit: Edit,
    done: Done,
    state: State,
    /// How the two submaps of a closure fit before and after.
    fits: Option<[PairFit; 2]>,
}

/// An edit that was tried.
#[derive(Clone, Debug, Serialize)]
pub struct Trial {
    /// What it is called.
    pub kind: &'static str,
    /// What it does, in words.
    pub words: String,
    /// How the two submaps of a closure fit before and after; `null` for other edits, and where they have no surfaces in the same places.
    pub fits: Option<[PairFit; 2]>,
}

/// What edits have made of a submap.
#[derive(Clone, Debug, Serialize)]
pub struct Change {
    /// The submap.
    pub submap: SubmapId,
    /// How far its scans moved at most, metres.
    pub moved_m: f64,
    /// Whether something of it was erased or added.
    pub has_changed: bool,
}

/// A closure with where its scans are.
#[derive(Clone, Debug, Serialize)]
pub struct ShownClosure {
    /// The closure.
    #[serde(flatten)]
    pub listed: ListedClosure,
    /// Positions of its scans, metres from the map's origin.
    pub ends: [[f64; 3]; 2],
}

impl Draft {
    /// Opens a map: to edit it, or, if somebody else edits or writes it, to look at it as it is. To be called in a pool.
    ///
    /// # Errors
    /// A map that is none or is damaged, and edits that cannot be done again.
    pub fn open(map: &Path) -> Result<Self> {
        let editor = match MapEditor::open(map) {
            Ok(editor) => Editor::of(editor)?,
            Err(error @ voxelastic_io::Error::Locked { .. }) => return Self::read_only(map, &locked(error)),
            Err(error) => return Err(error.into()),
        };
        let first = State::of(editor.map.base())?;
        let (mut state, mut steps) = (first.clone(), Vec::new());
        replay(&mut state, map, &mut editor.edits.clone(), |edit, done, state| {
            steps.push(Step { edit: edit.clone(), done, state: state.clone(), fits: None });
        })?;
        let loops = loops_of(editor.map.base())?;
        Ok(Self {
            dir: map.to_owned(),
            editor: Some(editor),
            read_only: None,
            fixed: Vec::new(),
            first,
            steps,
            undone: Vec::new(),
            trial: None,
            saved: state,
            shows_saved: false,
            loops,
        })
    }

    fn read_only(map: &Path, why: &Error) -> Result<Self> {
        let store = map_files::open(map)?;
        let (fixed, first, loops) = (edits(&store)?, State::of(&store)?, loops_of(&store)?);
        let read_only = Some(why.to_string());
        Ok(Self {
            dir: map.to_owned(),
            editor: None,
            read_only,
            fixed,
            saved: first.clone(),
            first,
            steps: Vec::new(),
            undone: Vec::new(),
            trial: None,
            shows_saved: false,
            loops,
        })
    }

    /// Why the map cannot be edited, if so.
    pub fn why_read_only(&self) -> Option<&str> {
        self.read_only.as_deref()
    }

    /// Where the coordinates of submaps, scans and closures are counted from. Those of edits are counted from zero.
    pub fn origin(&self) -> Origin {
        self.first.origin
    }

    /// The edits so far, without the one that is tried.
    pub fn edits(&self) -> impl Iterator<Item = &Edit> {
        self.fixed.iter().chain(self.steps.iter().map(|step| &step.edit))
    }

    /// How many edits can be done again.
    pub fn undone(&self) -> usize {
        self.undone.len()
    }

    /// How many of the edits, from the first on, are on the disk; and whether the disk has nothing else.
    pub fn saved(&self) -> (usize, bool) {
        let Some(editor) = &self.editor else { return (self.fixed.len(), true) };
        let common = editor.edits.iter().zip(&self.steps).take_while(|(saved, step)| **saved == step.edit).count();
        (common, common == editor.edits.len() && common == self.steps.len())
    }

    /// The edit that is tried.
    pub fn trial(&self) -> Option<Trial> {
        self.trial.as_ref().map(|step| Trial { kind: step.done.kind, words: step.done.words(), fits: step.fits })
    }

    /// Tries an edit on the map with those before: what is shown is the map with it, until it is [accepted](Self::accept) or [dropped](Self::discard). One that
    /// was tried before gives way. To be called in a pool.
    ///
    /// # Errors
    /// An edit that the map refuses; the map is shown without one then.
    pub fn attempt(&mut self, mut edit: Edit) -> Result<()> {
        if let Some(why) = &self.read_only {
            return Err(Error::new(why.clone(), "wait for it to end, and open the page again"));
        }
        (self.trial, self.shows_saved) = (None, false);
        let before = self.steps.last_mut().map_or(&mut self.first, |step| &mut step.state);
        if edit.needs_graph() {
            // It is the same for all that is tried on this map.
            before.graph()?;
        }
        let mut state = before.clone();
        let done = state.apply(&mut edit)?;
        let fits = match edit {
            Edit::Closure { between: Between::Submaps(submaps), .. } => fit(before, submaps)?.zip(fit(&state, submaps)?).map(<[PairFit; 2]>::from),
            _ => None,
        };
        self.trial = Some(Step { edit, done, state, fits });
        Ok(())
    }

    /// Takes the edit that is tried; false if there is none. What was undone cannot be done again then.
    pub fn accept(&mut self) -> bool {
        let Some(step) = self.trial.take() else { return false };
        self.undone.clear();
        self.steps.push(step);
        true
    }

    /// Drops the edit that is tried; false if there is none.
    pub fn discard(&mut self) -> bool {
        self.trial.take().is_some()
    }

    /// Takes the last edit back; false if there is none.
    pub fn undo(&mut self) -> bool {
        (self.trial, self.shows_saved) = (None, false);
        move_last(&mut self.steps, &mut self.undone)
    }

    /// Does the edit again that was undone last; false if there is none.
    pub fn redo(&mut self) -> bool {
        (self.trial, self.shows_saved) = (None, false);
        move_last(&mut self.undone, &mut self.steps)
    }

    /// Writes the edits: when this returns, the map on the disk is durable, and the one that is shown without what is tried. To be called in a pool.
    ///
    /// # Errors
    /// A map that cannot be written; it is as it was before then, or has those of its edits that this draft begins with.
    pub fn save(&mut self) -> Result<()> {
        let (common, is_saved) = self.saved();
        let Some(editor) = &mut self.editor else {
            return Err(Error::new(self.read_only.clone().unwrap_or_else(|| "the map is not open".to_owned()), "open the page again"));
        };
        if is_saved {
            return Ok(());
        }
        self.saved = self.steps.last().map_or(&self.first, |step| &step.state).clone();
        if self.steps.is_empty() {
            // Not a byte is left of the edits then, which needs the lock for itself.
            drop(self.editor.take());
            let undone = undo_all(&self.dir);
            let reopened = Editor::open(&self.dir);
            self.read_only = reopened.as_ref().err().map(Error::one_line);
            self.editor = Some(reopened?);
            return undone;
        }
        let edits = |count: usize| self.steps[..count].iter().map(|step| step.edit.clone()).collect();
        if common < editor.edits.len() {
            let state = common.checked_sub(1).map_or(&self.first, |last| &self.steps[last].state);
            editor.replace(state, edits(common))?;
        }
        match self.steps.last() {
            Some(step) if common < self.steps.len() => editor.replace(&step.state, edits(self.steps.len())),
            _ => Ok(()),
        }
    }

    /// Shows the map as it is on the disk, for comparison, or the one with all edits again.
    pub fn show_saved(&mut self, shows_saved: bool) {
        self.shows_saved = shows_saved;
    }

    /// Whether what is shown is the map on the disk.
    pub fn shows_saved(&self) -> bool {
        self.shows_saved
    }

    /// What the edits, with the one that is tried, make another one than it is on the disk: submaps with how far their scans moved at most, metres, and whether their
    /// fields are others.
    pub fn changes(&self) -> Vec<Change> {
        let now = self.edited();
        let of = |entry: &SubmapEntry| {
            let before = self.saved.entry(entry.id).ok()?;
            let moved = |(a, b): ((_, Pose), (_, Pose))| (before.t_map_submap * a.1).translation_distance(&(entry.t_map_submap * b.1));
            let moved_m = graph::now(before).zip(graph::now(entry)).map(moved).fold(0.0, f64::max);
            let has_changed = match (self.saved.changed.get(&entry.id), now.changed.get(&entry.id)) {
                (Some(a), Some(b)) => !Arc::ptr_eq(a, b),
                (None, None) => false,
                _ => true,
            };
            (moved_m > LEAST_MOVED || has_changed).then_some(Change { submap: entry.id, moved_m, has_changed })
        };
        now.entries.iter().filter_map(of).collect()
    }

    /// The map that is shown.
    fn state(&self) -> &State {
        if self.shows_saved { &self.saved } else { self.edited() }
    }

    /// The map with all edits, and with the one that is tried.
    fn edited(&self) -> &State {
        let last = self.trial.as_ref().or(self.steps.last());
        last.map_or(&self.first, |step| &step.state)
    }

    /// The submaps with their poses, metres from the map's origin.
    pub fn submaps(&self) -> impl Iterator<Item = (SubmapId, Pose)> {
        self.state().entries.iter().map(|entry| (entry.id, entry.t_map_submap))
    }

    /// A submap whose fields an edit has changed; none if they are those of before all edits.
    pub fn changed(&self, id: SubmapId) -> Option<&Arc<Submap>> {
        self.state().changed.get(&id)
    }

    /// A submap as it is now.
    ///
    /// # Errors
    /// When there is none with this number, or its file cannot be read.
    pub fn submap(&self, id: SubmapId) -> Result<Submap> {
        self.state().submap(id)
    }

    /// The scans, in the order of their nodes, each with its submap and its pose in the frame of that.
    pub fn path(&self) -> Vec<(NodeId, SubmapId, Pose)> {
        let mut path: Vec<_> =
            self.state().entries.iter().flat_map(|entry| graph::now(entry).map(|(node, t_submap_lidar)| (node, entry.id, t_submap_lidar))).collect();
        path.sort_by_key(|(node, ..)| *node);
        path
    }

    /// The closures, the one that the poses contradict most first.
    pub fn closures(&self) -> Vec<ShownClosure> {
        let poses = graph::poses(&self.state().entries);
        // What the edits of a map that somebody else has did is in its poses; its loop edges are those of before them.
        let on_disk = self.editor.iter().flat_map(|editor| &editor.edits).filter(|_| self.shows_saved);
        let drafted = self.edits().chain(self.trial.iter().map(|step| &step.edit)).filter(|_| !self.shows_saved);
        let edits = on_disk.chain(drafted);
        let at: HashMap<NodeId, [f64; 3]> = poses.iter().map(|(node, pose)| (*node, pose.translation.vector.into())).collect();
        let shown = |listed: ListedClosure| {
            let [a, b] = listed.scans;
            Some(ShownClosure { ends: [*at.get(&a)?, *at.get(&b)?], listed })
        };
        listed(self.loops.clone(), edits, &poses).into_iter().filter_map(shown).collect()
    }

    /// What is least consistent in the map as it is shown, and what would mend it. That looks at all surfaces. To be called in a pool.
    ///
    /// # Errors
    /// When a submap cannot be read.
    pub fn suggestions(&self) -> Result<Vec<Suggestion>> {
        let mut closures: Vec<ListedClosure> = self.closures().into_iter().map(|shown| shown.listed).collect();
        if self.read_only.is_some() {
            // The graph of a map that somebody else has is not known: its edits are in its poses.
            closures.clear();
        }
        suggestions(&mut self.state().clone(), &closures, &mut || ())
    }
}

/// Moves the last step to another list; false if there is none.
fn move_last(from: &mut Vec<Step>, to: &mut Vec<Step>) -> bool {
    let last = from.pop();
    let is_some = last.is_some();
    to.extend(last);
    is_some
}
