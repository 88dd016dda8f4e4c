//! Editing a saved map: a list of edits that is kept with the map, each done to what those before it have made.
//!
//! The map that is shown is a function of the map before the edits and of the list, and of nothing else: the same list on the same map gives the same bytes, and an edit
//! that is taken back leaves those of before it. Places that were registered are written into the list as they were found, so nothing is looked for twice.
//!
//! | module | contents |
//! | --- | --- |
//! | [`Edit`] | what can be done, as a table of TOML |
//! | `parse` | reading a list; what is wrong is named by line and key |
//! | [`Region`] | boxes, spheres, prisms |
//! | `graph` | the pose graph of a saved map, and what edits add to it |
//! | `register` | two submaps, by their surfaces |
//! | `state` | what each edit does |
//! | [`Editor`] | a map that is edited, on disk |

mod graph;
mod list;
mod parse;
mod region;
mod register;
mod state;
#[cfg(test)]
mod tests;

pub use list::{Between, Edit, Pin, SessionName, Target, Up};
pub use parse::parse;
pub use region::Region;
pub use register::Fit;
pub use state::Done;

use crate::error::{During, Error, Result};
use crate::map_files;
use serde::Serialize;
use state::State;
use std::path::Path;
use voxelastic::event::{Edge, NodeId};
use voxelastic::geometry::PoseExt;
use voxelastic_io::store::{MapEditor, MapStore, NewState};

/// A closure of a map.
#[derive(Clone, Debug, Serialize)]
pub struct ListedClosure {
    /// Its scans.
    pub scans: [NodeId; 2],
    /// How far the second is, by the poses of the map, from where the closure has it in the frame of the first, metres.
    pub off_m: f64,
}

/// The one editor of a map. Everything it does is on the disk when it returns.
pub struct Editor {
    map: MapEditor,
    edits: Vec<Edit>,
    /// The map with the edits; none until somebody needs it.
    state: Option<State>,
}

impl Editor {
    /// Opens a map to edit it. Nobody else can edit or write it meanwhile.
    ///
    /// # Errors
    /// A map that is no map, that another process writes, or whose list of edits is damaged.
    pub fn open(map: &Path) -> Result<Self> {
        let map = MapEditor::open(map).map_err(|error| match error {
            voxelastic_io::Error::Locked { path, pid } => Error::new(
                format!("{}: process {pid} edits or writes this map, so that it is read-only", path.display()),
                "wait for it to end; `--list` shows the edits meanwhile",
            ),
            error => error.into(),
        })?;
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

    fn state(&mut self) -> Result<&mut State> {
        let state = match self.state.take() {
            Some(state) => state,
            None => replayed(self.map.base(), &mut self.edits)?,
        };
        Ok(self.state.insert(state))
    }
}

/// The edits that a map is shown with. Somebody may be editing it.
///
/// # Errors
/// A map that is none, and a list that is not that of the map.
pub fn edits(store: &MapStore) -> Result<Vec<Edit>> {
    parse(&store.edits()?, &store.dir().join("edits.toml").display().to_string())
}

/// The closures of a map as it is shown: those of its run, of its sessions and of its edits, the one that the poses contradict most first.
///
/// # Errors
/// As for [`edits`], and a log of the run that is damaged.
pub fn closures(store: &MapStore) -> Result<Vec<ListedClosure>> {
    let manifest = store.manifest();
    let poses = graph::poses(&manifest.submaps);
    let mut all = graph::loops(&map_files::read_run_log(store)?.unwrap_or_default(), &manifest.all_sessions(), &poses);
    for edit in edits(store)? {
        match edit {
            Edit::Closure { edges, .. } => all.extend(edges),
            Edit::RemoveClosure { scans: [a, b] } => all.retain(|edge| ![[a, b], [b, a]].contains(&[edge.from, edge.to])),
            _ => {}
        }
    }
    let listed = |edge: &Edge| {
        let now = poses.get(&edge.from)?.inv_mul(poses.get(&edge.to)?);
        Some(ListedClosure { scans: [edge.from, edge.to], off_m: now.translation_distance(&edge.t_from_to) })
    };
    let mut listed: Vec<ListedClosure> = all.iter().filter_map(listed).collect();
    listed.sort_by(|a, b| b.off_m.total_cmp(&a.off_m).then(a.scans.cmp(&b.scans)));
    Ok(listed)
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

/// The edits of a file.
///
/// # Errors
/// A file that cannot be read, or is no list of edits: what is wrong is named by line and key.
pub fn read(file: &Path) -> Result<Vec<(usize, Edit)>> {
    let name = file.display().to_string();
    let text = std::fs::read_to_string(file)
        .map_err(|error| Error::new(format!("{name}: {error}"), "give a list of edits: `[[edit]]` tables in a text file"))?;
    parse::parse_with_lines(&text, &name)
}

/// A map with edits that it had before.
fn replayed(base: &MapStore, edits: &mut [Edit]) -> Result<State> {
    let mut state = State::of(base)?;
    for (k, edit) in edits.iter_mut().enumerate() {
        state.apply(edit).during(format!("edit {} of {} cannot be done again", k + 1, base.dir().display()))?;
    }
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
