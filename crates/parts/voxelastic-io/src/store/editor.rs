//! A map with edits: the list of them, and the map of before, kept beside the map that they make of it.
//!
//! `edits.toml` is the list, `base.json` the manifest of before the first edit, whose submap files stay. The manifest has a mark that says which first bytes of the list
//! it is made with, and is replaced last, so a process that dies at any moment leaves the state before or the new one: what the list has beyond the mark is of an edit that
//! was never complete. With no edit left, the manifest is that of before again, byte for byte, and nothing else stays.

use super::additions::sessions::SessionEntry;
use super::description::manifest::{EditsMark, Manifest, SubmapEntry};
use super::description::piece::{MapDetails, Piece, check_storable};
use super::description::pose_as_numbers;
use super::files::{self, BASE, EDITS, EDITS_HEADER as HEADER, MANIFEST, SubmapName};
use super::known_file::KnownFile;
use super::lock::Lock;
use super::reader::MapStore;
use super::sections::submap_file::{self, Written};
use super::writer::{MapWriter, RunLogFate, SaveReport, names};
use crate::{Error, Position, Result};
use rayon::prelude::*;
use std::collections::HashMap;
use std::fs;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;
use voxelastic::atlas::{Submap, SubmapId};

/// Submaps whose files are there, with their entries.
type WrittenSubmaps = HashMap<SubmapId, (Arc<Submap>, SubmapEntry)>;

/// The one editor of a map directory, from when it is made until it is dropped.
#[derive(Debug)]
pub struct MapEditor {
    writer: MapWriter,
    base: MapStore,
    list: String,
    /// What the map that is shown has of submaps that are others than before the edits: of the same in memory, the file is there.
    written: WrittenSubmaps,
}

/// A map as edits make it of the one before.
#[derive(Clone, Debug)]
pub struct NewState {
    /// The submaps, ordered by id. What files hold of those that changed is filled in.
    pub entries: Vec<SubmapEntry>,
    /// The submaps whose fields are others than before the edits.
    pub changed: Vec<Arc<Submap>>,
    /// How the map was made.
    pub details: MapDetails,
    /// The sessions, as the manifest has them.
    pub sessions: Vec<SessionEntry>,
    /// Number of the edits.
    pub count: usize,
    /// The edits as text, without a header.
    pub list: String,
}

impl MapEditor {
    /// Opens the map at `path` to edit it. Nobody else can write it meanwhile.
    ///
    /// # Errors
    /// As for [`MapStore::open`], [`Error::Locked`]; [`Error::Content`] for a list that is not the one that the map was made with.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let (store, lock) = locked(path.as_ref())?;
        let list = read_list(&store)?;
        let base = store.before_edits()?;
        Ok(Self { writer: MapWriter::new(store, lock), base, list, written: HashMap::new() })
    }

    /// The map before the edits.
    pub fn base(&self) -> &MapStore {
        &self.base
    }

    /// The map with the edits.
    pub fn shown(&self) -> &MapStore {
        self.writer.store()
    }

    /// The edits that the map is shown with, as text without a header; empty without any.
    pub fn list(&self) -> &str {
        &self.list
    }

    /// Makes `state` the map that is shown. Its list must begin with the list so far, or the other way round. When this returns, the map is durable; when it fails or the
    /// process dies, it is the one before.
    ///
    /// # Errors
    /// [`Error::Unwritable`] when a pose is not finite; [`Error::Io`] when the file system refuses.
    pub fn save(&mut self, state: NewState) -> Result<SaveReport> {
        let saved = self.write(state);
        let (report, list, written) = saved.inspect_err(|_| clean(&self.base))?;
        (self.list, self.written) = (list, written);
        Ok(report)
    }

    fn write(&mut self, state: NewState) -> Result<(SaveReport, String, WrittenSubmaps)> {
        let dir = self.base.dir().to_owned();
        let NewState { mut entries, changed, details, sessions, count, list } = state;
        check_poses(&entries, &dir)?;
        if self.shown().manifest().edits.is_none() {
            let before = files::read(&dir.join(MANIFEST), None)?;
            files::write_atomically(&dir, BASE, |file| file.write_all(&before).and_then(|()| file.sync_all()))?;
        }
        let write = |submap: &Arc<Submap>| match self.written.get(&submap.id()) {
            Some((same, entry)) if Arc::ptr_eq(same, submap) => Ok((entry.clone(), false)),
            _ => self.write_submap(submap),
        };
        let written: Vec<Result<(SubmapEntry, bool)>> = changed.par_iter().map(write).collect();
        let written = written.into_iter().collect::<Result<Vec<_>>>()?;
        let now = changed.iter().zip(&written).map(|(submap, (entry, _))| (submap.id(), (Arc::clone(submap), entry.clone()))).collect();
        let mut report = SaveReport::default();
        let mut of_submap: HashMap<SubmapId, (SubmapEntry, bool)> = written.into_iter().map(|(entry, is_new)| (entry.id, (entry, is_new))).collect();
        for entry in &mut entries {
            let mut is_new = false;
            if let Some((written, new)) = of_submap.remove(&entry.id) {
                let SubmapEntry { file, bytes, crc32, tsdf, occupancy, .. } = written;
                (entry.file, entry.bytes, entry.crc32, entry.tsdf, entry.occupancy, is_new) = (file, bytes, crc32, tsdf, occupancy, new);
            }
            report.bytes += entry.bytes;
            report.bytes_written += if is_new { entry.bytes } else { 0 };
            *if is_new { &mut report.written } else { &mut report.kept } += 1;
        }
        let grows = list.starts_with(&self.list);
        let text = format!("{HEADER}{list}");
        let write_list = || files::write_atomically(&dir, EDITS, |file| file.write_all(text.as_bytes()).and_then(|()| file.sync_all()));
        if grows {
            write_list()?;
        }
        files::sync_dir(&dir)?;
        let manifest = Manifest { details, sessions, submaps: entries, edits: Some(EditsMark::of(&text, count)) };
        let bytes = self.writer.replace_manifest(manifest, RunLogFate::Kept, |_| Ok(()))?;
        report.bytes += bytes;
        report.bytes_written += bytes + text.len() as u64;
        files::sync_dir(&dir)?;
        // From here on the new state is the map, whatever happens.
        if !grows {
            write_list()?;
            files::sync_dir(&dir)?;
        }
        report.removed = files::remove_others(&dir, |name| names(self.shown(), name) || names(&self.base, name))?;
        Ok((report, list, now))
    }

    /// Writes the file of a submap that is another one than before the edits. It depends on its content, and not on which edits came in between: with the poses of before.
    fn write_submap(&self, submap: &Submap) -> Result<(SubmapEntry, bool)> {
        let manifest = self.base.manifest();
        let base = self.base.entry(submap.id()).ok_or_else(|| Error::NoSuchSubmap { path: self.base.dir().to_owned(), id: submap.id() })?;
        let session = manifest.sessions.iter().find(|session| session.has(submap.id()) && session.t_map_session.is_some());
        let piece = Piece { submap, t_map_submap: base.t_map_submap, session };
        check_storable(&piece, self.base.dir())?;
        let name = SubmapName { id: submap.id(), digest: submap_file::digest(submap) };
        // The file of before has this content, perhaps with other poses in it: it stays.
        let is_base = name.to_string() == base.file;
        let known =
            is_base.then(|| KnownFile { name, written: Written { bytes: base.bytes, crc32: base.crc32 }, path: self.base.dir().join(&base.file) });
        self.writer.save_piece(&piece, &manifest.details, known)
    }

    /// Makes the map at `path` what it was before all edits, byte for byte, and forgets them. Its manifest may be damaged.
    ///
    /// # Errors
    /// [`Error::Locked`], [`Error::Io`]; [`Error::Missing`] or [`Error::Damaged`] when what was there before the edits is not known. The map has its edits then.
    pub fn restore(path: impl AsRef<Path>) -> Result<()> {
        let dir = path.as_ref();
        let _lock = Lock::take(dir)?;
        match MapStore::open(dir) {
            Ok(store) if store.manifest().edits.is_none() => Ok(()),
            Err(error) if !dir.join(BASE).exists() => Err(error),
            _ => MapStore::open_base(dir).and_then(|_| put_back(dir)),
        }
    }

    /// Makes the edits part of the map at `path`: they cannot be undone then. The list and what was there before may be damaged.
    ///
    /// # Errors
    /// [`Error::Locked`], what [`MapStore::open`] says, and [`Error::Io`]; the edits are as before then.
    pub fn keep(path: impl AsRef<Path>) -> Result<()> {
        let (store, lock) = locked(path.as_ref())?;
        if store.manifest().edits.is_none() {
            return Ok(());
        }
        let dir = store.dir().to_owned();
        let manifest = Manifest { edits: None, ..store.manifest().clone() };
        let mut writer = MapWriter::new(store, lock);
        writer.replace_manifest(manifest, RunLogFate::Kept, |_| Ok(()))?;
        files::sync_dir(&dir)?;
        remove(&dir)?;
        files::remove_others(&dir, |name| names(writer.store(), name)).map(drop)
    }
}

/// Takes the lock of a map, and opens it.
fn locked(dir: &Path) -> Result<(MapStore, Lock)> {
    MapStore::open(dir)?;
    let lock = Lock::take(dir)?;
    // Once more: another writer may have saved before the lock was ours.
    Ok((MapStore::open(dir)?, lock))
}

impl MapStore {
    /// The edits that the map is shown with, as text without a header; empty without any. It takes no lock: an editor may be at work.
    ///
    /// # Errors
    /// [`Error::Content`] for a list that is not the one that the map was made with, [`Error::Missing`] and [`Error::Io`].
    pub fn edits(&self) -> Result<String> {
        read_list(self)
    }
}

/// Removes what a save that failed has written, because it would keep a full disk full. It may have failed after the manifest was replaced: that on the disk decides. What
/// cannot be removed is left for the next save.
fn clean(base: &MapStore) {
    let Ok(there) = MapStore::open(base.dir()) else { return };
    let _ = files::remove_others(there.dir(), |name| names(&there, name) || names(base, name));
    if there.manifest().edits.is_none() {
        let _ = remove(there.dir());
    }
}

/// The edits that a manifest is made with.
fn read_list(store: &MapStore) -> Result<String> {
    let path = store.dir().join(EDITS);
    let other = |remedy: &'static str| Error::content(&path, Position::File, "it is not the list that the map was made with", remedy);
    let Some(mark) = store.manifest().edits else {
        // A list of somebody else would be overwritten by the first edit.
        let is_ours = !path.exists() || files::read(&path, None)?.starts_with(HEADER.as_bytes());
        return if is_ours { Ok(String::new()) } else { Err(other("the map has no edits: move the file elsewhere")) };
    };
    let text = files::read(&path, None)?;
    let list = usize::try_from(mark.bytes).ok().and_then(|bytes| text.get(..bytes)).filter(|list| crc32fast::hash(list) == mark.crc32);
    let list = list.and_then(|list| std::str::from_utf8(list).ok()).and_then(|list| list.strip_prefix(HEADER));
    let remedy =
        "restore it from a backup; or `voxelastic edit MAP --keep` makes the map as it is one without edits, `--undo all` the one before them";
    list.map(str::to_owned).ok_or_else(|| other(remedy))
}

/// Makes the manifest of before the edits the manifest.
fn put_back(dir: &Path) -> Result<()> {
    let before = files::read(&dir.join(BASE), None)?;
    files::write_atomically(dir, MANIFEST, |file| file.write_all(&before).and_then(|()| file.sync_all()))?;
    files::sync_dir(dir)?;
    remove(dir)?;
    let store = MapStore::open(dir)?;
    files::remove_others(dir, |name| names(&store, name)).map(drop)
}

/// Removes the list and the manifest of before, of a map without edits.
fn remove(dir: &Path) -> Result<()> {
    for name in [EDITS, BASE] {
        let path = dir.join(name);
        match voxelastic_files::failpoint::check("remove", &path).and_then(|()| fs::remove_file(&path)) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(Error::on_io("remove", &path)(error)),
            _ => {}
        }
    }
    files::sync_dir(dir)
}

/// Refuses poses that the manifest cannot hold.
fn check_poses(entries: &[SubmapEntry], dir: &Path) -> Result<()> {
    for entry in entries {
        for pose in entry.corrected.iter().map(|scan| &scan.t_submap_lidar).chain([&entry.t_map_submap]) {
            pose_as_numbers::check(pose).map_err(|e| Error::unwritable(dir, format!("submap {}: a pose {e}", entry.id)))?;
        }
    }
    Ok(())
}
