//! A map that is edited, on disk.

use super::list::Edit;
use super::parse::parse;
use super::state::{Done, State};
use crate::error::{During, Error, Result};
use std::path::Path;
use voxelastic_io::store::{MapEditor, MapStore, NewState};

/// The one editor of a map. Everything it does is on the disk when it returns.
pub struct Editor {
    pub(super) map: MapEditor,
    pub(super) edits: Vec<Edit>,
    /// The map with the edits; none until somebody needs it.
    state: Option<State>,
}

impl Editor {
    /// Opens a map to edit it. Nobody else can edit or write it meanwhile.
    ///
    /// # Errors
    /// A map that is no map, that another process writes, or whose list of edits is damaged.
    pub fn open(map: &Path) -> Result<Self> {
        MapEditor::open(map).map_err(locked).and_then(Self::of)
    }

    /// The editor of a map that is open.
    pub(super) fn of(map: MapEditor) -> Result<Self> {
        let edits = parse(map.list(), &map.shown().dir().join("edits.toml").display().to_string())?;
        Ok(Self { map, edits, state: None })
    }

    /// The edits that the map is shown with, in order.
    pub fn edits(&self) -> &[Edit] {
        &self.edits
    }

    /// The map with the edits.
    pub fn shown(&self) -> &MapStore {
        self.map.shown()
    }

    /// Makes an edit. When this returns, the map is durable; when it fails or the process dies, the map is as it was before. To be called in a pool.
    ///
    /// # Errors
    /// An edit that the map refuses, and a map that cannot be read or written.
    pub fn apply(&mut self, mut edit: Edit) -> Result<Done> {
        let mut state = self.state()?.clone();
        let done = state.apply(&mut edit)?;
        let list = format!("{}{}", self.map.list(), edit.to_text());
        self.map.save(new_state(&state, self.edits.len() + 1, list))?;
        self.edits.push(edit);
        self.state = Some(state);
        Ok(done)
    }

    /// Takes back the last `count` edits: the map is what it was before them, byte for byte. Returns how many are left. To be called in a pool.
    ///
    /// # Errors
    /// When there are not so many, and as for [`apply`](Self::apply).
    pub fn undo(mut self, count: usize) -> Result<usize> {
        let Some(left) = self.edits.len().checked_sub(count) else {
            return Err(Error::usage(format!("the map has {} edits", self.edits.len()), "`--list` shows them; `--undo all` takes all of them back"));
        };
        if left == 0 {
            let dir = self.map.shown().dir().to_owned();
            drop(self);
            undo_all(&dir)?;
        } else if count > 0 {
            let state = replayed(self.map.base(), &mut self.edits[..left])?;
            let list = self.edits[..left].iter().map(Edit::to_text).collect();
            self.map.save(new_state(&state, left, list))?;
        }
        Ok(left)
    }

    /// Makes a state that was made of the map before all edits by `edits` the map that is shown.
    pub(super) fn replace(&mut self, state: &State, edits: Vec<Edit>) -> Result<()> {
        let list = edits.iter().map(Edit::to_text).collect();
        self.map.save(new_state(state, edits.len(), list))?;
        (self.edits, self.state) = (edits, Some(state.clone()));
        Ok(())
    }

    fn state(&mut self) -> Result<&mut State> {
        let state = match self.state.take() {
            Some(state) => state,
            None => replayed(self.map.base(), &mut self.edits)?,
        };
        Ok(self.state.insert(state))
    }
}

/// Takes back all edits of a map, whose manifest may be damaged: it is what it was before them, byte for byte.
///
/// # Errors
/// A map that another process writes; one of which nobody knows what it was before.
pub fn undo_all(map: &Path) -> Result<()> {
    MapEditor::restore(map).map_err(Error::from)
}

/// Makes the edits part of the map: they cannot be taken back then.
///
/// # Errors
/// A map that another process writes, or that is damaged.
pub fn keep(map: &Path) -> Result<()> {
    MapEditor::keep(map).map_err(Error::from)
}

/// Says who has the lock of a map.
pub(super) fn locked(error: voxelastic_io::Error) -> Error {
    match error {
        voxelastic_io::Error::Locked { path, pid } => Error::new(
            format!("{}: process {pid} edits or writes this map, so that it is read-only", path.display()),
            "wait for it to end; `--list` shows the edits meanwhile",
        ),
        error => error.into(),
    }
}

/// Does edits again on the map of before them, and calls `each` with each and the map with it.
pub(super) fn replay(state: &mut State, map: &Path, edits: &mut [Edit], mut each: impl FnMut(&Edit, Done, &State)) -> Result<()> {
    for (k, edit) in edits.iter_mut().enumerate() {
        let done = state.apply(edit).during(format!("edit {} of {} cannot be done again", k + 1, map.display()))?;
        each(edit, done, state);
    }
    Ok(())
}

/// A map with edits that it had before.
fn replayed(base: &MapStore, edits: &mut [Edit]) -> Result<State> {
    let mut state = State::of(base)?;
    replay(&mut state, base.dir(), edits, |_, _, _| ())?;
    Ok(state)
}

fn new_state(state: &State, count: usize, list: String) -> NewState {
    NewState {
        entries: state.entries.clone(),
        changed: state.changed.values().cloned().collect(),
        details: state.details(),
        sessions: state.sessions.clone(),
        count,
        list,
    }
}
