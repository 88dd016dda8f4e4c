//! Saving an atlas to a map directory.

use super::additions::sessions::SessionEntry;
use super::description::manifest::{Manifest, SubmapEntry};
use super::description::manifest_text;
use super::description::piece::{MapDetails, Piece, check_storable};
use super::files::{self, LOCK, MANIFEST, RUN_LOG, SubmapName, UNFINISHED};
use super::known_file::KnownFile;
use super::leftovers;
use super::lock::Lock;
use super::reader::MapStore;
use super::sections::submap_file::{self, Written};
use crate::{Error, Result};
use rayon::prelude::*;
use std::collections::HashSet;
use std::io::{ErrorKind, Write};
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use voxelastic::atlas::Atlas;
use voxelastic_files::failpoint;

/// The one writer of a map directory, from when it is made until it is dropped.
#[derive(Debug)]
pub struct MapWriter {
    store: MapStore,
    /// Names of submap files that this writer wrote or found whole.
    whole: Mutex<HashSet<String>>,
    _lock: Lock,
}

/// What becomes of the log of the run when the manifest is replaced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum RunLogFate {
    /// It tells of what stays.
    Kept,
    /// It is that of another map.
    Removed,
}

/// What a save did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct SaveReport {
    /// Submaps written because their content was new.
    pub written: usize,
    /// Submaps whose files were kept.
    pub kept: usize,
    /// Bytes of the files written, the manifest included.
    pub bytes_written: u64,
    /// Bytes of the whole map.
    pub bytes: u64,
    /// Files removed because the map no longer needs them.
    pub removed: usize,
}

impl MapWriter {
    /// Makes `path` a map directory to write to, with its parents. A map that is already there stays until the first
    /// [`save`](Self::save) replaces it.
    ///
    /// # Errors
    /// [`Error::WouldOverwrite`] when the directory holds anything else, [`Error::NotAMap`] when `path` is a file,
    /// [`Error::Locked`], [`Error::Edited`], what [`MapStore::open`] says about a map that is there, and [`Error::Io`].
    pub fn create(path: impl AsRef<Path>) -> Result<Self> {
        let dir = path.as_ref();
        if dir.is_file() {
            return Err(Error::NotAMap { path: dir.to_owned(), reason: "it is a file; choose a directory" });
        }
        let was_there = dir.exists();
        let created = Self::create_in(dir);
        if created.is_err() && !was_there {
            // What is left takes space, and a name.
            let _ = std::fs::remove_file(dir.join(LOCK)).and_then(|()| std::fs::remove_dir(dir));
        }
        created
    }

    fn create_in(dir: &Path) -> Result<Self> {
        std::fs::create_dir_all(dir).map_err(Error::on_io("create", dir))?;
        // Looked at before the lock is made, so that nothing is left in a directory that is not ours.
        check_is_ours(dir)?;
        let lock = Lock::take(dir)?;
        let is_map = check_is_ours(dir)?;
        let store = if is_map { MapStore::open(dir)? } else { MapStore::empty(dir) };
        store.check_unedited()?;
        Ok(Self::new(store, lock))
    }

    /// Opens the map at `path` to save to it again.
    ///
    /// # Errors
    /// As for [`MapStore::open`], [`Error::Locked`], and [`Error::Edited`].
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let dir = path.as_ref();
        MapStore::open(dir)?;
        let lock = Lock::take(dir)?;
        // Once more: another writer may have saved before the lock was ours.
        let store = MapStore::open(dir)?;
        store.check_unedited()?;
        Ok(Self::new(store, lock))
    }

    /// Of a map whose lock is held.
    pub(super) fn new(store: MapStore, lock: Lock) -> Self {
        leftovers::remove_leftovers(&store);
        Self { store, whole: Mutex::default(), _lock: lock }
    }

    /// Gives up. A directory that holds nothing but the lock, because nothing was ever saved to it, goes again.
    pub fn abandon(self) {
        let dir = self.store.dir().to_owned();
        // Fails where an unfinished run is.
        let _ = std::fs::remove_dir(dir.join(UNFINISHED));
        let is_bare = files::names(&dir).is_ok_and(|names| names.iter().all(|name| name == LOCK));
        if is_bare && std::fs::remove_file(dir.join(LOCK)).is_ok() {
            drop(self);
            // Fails, and does no harm, where another process has begun a map here meanwhile.
            let _ = std::fs::remove_dir(dir);
        }
    }

    /// The map as it was last saved.
    pub fn store(&self) -> &MapStore {
        &self.store
    }

    /// Forgets the scans in the manifest of the map that was saved: they are on the disk.
    pub(super) fn forget_scans(&mut self) {
        self.store.forget_scans();
    }

    /// Saves `atlas`. Submaps whose content is that of their file are not written again. When this returns, the map is
    /// durable; when it fails or the process dies, the map is the one saved before.
    ///
    /// # Errors
    /// [`Error::Unwritable`] when a pose is not finite, [`Error::Io`] when the file system refuses.
    pub fn save(&mut self, atlas: &Atlas, details: &MapDetails) -> Result<SaveReport> {
        self.save_with(atlas, details, |_| None)
    }

    /// As [`save`](Self::save), with files for submaps that are `known`.
    pub(super) fn save_with(
        &mut self,
        atlas: &Atlas,
        details: &MapDetails,
        known: impl Fn(&Piece<'_>) -> Option<KnownFile> + Sync,
    ) -> Result<SaveReport> {
        let saved = self.write_files(atlas, details, known).and_then(|saved| self.commit(saved, details, |_| Ok(())));
        let mut report = saved.inspect_err(|_| remove_unfinished(self.store.dir()))?;
        // From here on the new map is the map, whatever happens.
        files::sync_dir(self.store.dir())?;
        report.removed = files::remove_others(self.store.dir(), |name| names(&self.store, name))?;
        Ok(report)
    }

    /// Writes the files of submaps that are new and makes them durable; says of each whether it is.
    pub(super) fn write_files(
        &self,
        atlas: &Atlas,
        details: &MapDetails,
        known: impl Fn(&Piece<'_>) -> Option<KnownFile> + Sync,
    ) -> Result<Vec<(SubmapEntry, bool)>> {
        let pieces = pieces(atlas);
        pieces.iter().try_for_each(|piece| check_storable(piece, self.store.dir()))?;
        let saved: Vec<Result<(SubmapEntry, bool)>> = pieces.par_iter().map(|piece| self.save_piece(piece, details, known(piece))).collect();
        let saved: Vec<(SubmapEntry, bool)> = saved.into_iter().collect::<Result<_>>()?;
        if saved.iter().any(|(_, is_new)| *is_new) {
            files::sync_dir(self.store.dir())?;
        }
        Ok(saved)
    }

    /// Replaces the manifest by one of these submaps, or leaves it as it is. What belongs to it is written by `before`, which gets its text.
    pub(super) fn commit(
        &mut self,
        saved: Vec<(SubmapEntry, bool)>,
        details: &MapDetails,
        before: impl FnOnce(&str) -> Result<()>,
    ) -> Result<SaveReport> {
        self.commit_sessions(saved, details, Vec::new(), RunLogFate::Removed, before)
    }

    /// As [`commit`](Self::commit), of a map of these sessions; none for a map that is one session.
    pub(super) fn commit_sessions(
        &mut self,
        saved: Vec<(SubmapEntry, bool)>,
        details: &MapDetails,
        sessions: Vec<SessionEntry>,
        log: RunLogFate,
        before: impl FnOnce(&str) -> Result<()>,
    ) -> Result<SaveReport> {
        let mut report = SaveReport::default();
        for (entry, is_new) in &saved {
            report.bytes += entry.bytes;
            report.bytes_written += if *is_new { entry.bytes } else { 0 };
            *if *is_new { &mut report.written } else { &mut report.kept } += 1;
        }
        let submaps = saved.into_iter().map(|(entry, _)| entry).collect();
        let bytes = self.replace_manifest(Manifest { details: details.clone(), sessions, submaps, edits: None }, log, before)?;
        report.bytes += bytes;
        report.bytes_written += bytes;
        Ok(report)
    }

    /// Replaces the manifest; what belongs to it is written by `before`, which gets its text. Returns its length.
    pub(super) fn replace_manifest(&mut self, manifest: Manifest, log: RunLogFate, before: impl FnOnce(&str) -> Result<()>) -> Result<u64> {
        let dir = self.store.dir();
        let path = dir.join(MANIFEST);
        let text = manifest_text::write(&manifest).map_err(|e| Error::on_io("write", &path)(e.into()))?;
        before(&text)?;
        files::write_atomically(dir, MANIFEST, |file| {
            file.write_all(text.as_bytes())?;
            file.sync_all()?;
            if log == RunLogFate::Kept {
                return Ok(());
            }
            // The log of an earlier run is not that of this map. It goes when nothing but the rename is left to do.
            let run_log = dir.join(RUN_LOG);
            match failpoint::check("remove", &run_log).and_then(|()| std::fs::remove_file(&run_log)) {
                Err(error) if error.kind() != ErrorKind::NotFound => {
                    Err(std::io::Error::new(error.kind(), format!("{} cannot be removed: {error}", run_log.display())))
                }
                _ => Ok(()),
            }
        })?;
        self.store.set_manifest(manifest);
        Ok(text.len() as u64)
    }

    /// Puts `text` beside the map as the log of the run that made it, after [`save`](Self::save), which removes any earlier one. It is no
    /// part of the map: runs differ in their times where maps are the same bit for bit.
    ///
    /// # Errors
    /// [`Error::Io`]; the map is not touched.
    pub fn write_run_log(&mut self, text: &str) -> Result<()> {
        let dir = self.store.dir();
        files::write_atomically(dir, RUN_LOG, |file| file.write_all(text.as_bytes()))?;
        files::sync_dir(dir)
    }

    /// Writes the file of a submap unless the map has one of the same content; says whether it did.
    pub(super) fn save_piece(&self, piece: &Piece<'_>, details: &MapDetails, known: Option<KnownFile>) -> Result<(SubmapEntry, bool)> {
        let (submap, dir) = (piece.submap, self.store.dir());
        let id = submap.id();
        if let Some(entry) = self.store.entry(id) {
            let name = known.as_ref().map_or_else(|| SubmapName { id, digest: submap_file::digest(submap) }, |known| known.name);
            if entry.file == name.to_string() && self.is_whole(entry) {
                let written = Written { bytes: entry.bytes, crc32: entry.crc32 };
                return Ok((SubmapEntry::new(piece, name, written), false));
            }
        }
        let write = || {
            files::write_and_name(dir, &SubmapName::unhashed(id).to_string(), |file| {
                let (written, digest) = submap_file::write(file, piece, details)?;
                let name = SubmapName { id, digest };
                Ok((name.to_string(), (name, written)))
            })
        };
        let (name, written) = match known {
            Some(known) if known.is_in(dir) || files::link(&known.path, &dir.join(known.name.to_string())) => (known.name, known.written),
            _ => write()?,
        };
        self.whole.lock().unwrap_or_else(PoisonError::into_inner).insert(name.to_string());
        Ok((SubmapEntry::new(piece, name, written), true))
    }

    /// Whether the file of `entry` is there and undamaged: one that is not is written again. It is read once.
    fn is_whole(&self, entry: &SubmapEntry) -> bool {
        let path = self.store.dir().join(&entry.file);
        if !path.metadata().is_ok_and(|m| m.is_file() && m.len() == entry.bytes) {
            return false;
        }
        let whole = || self.whole.lock().unwrap_or_else(PoisonError::into_inner);
        if whole().contains(&entry.file) {
            return true;
        }
        let is_whole = submap_file::check(&path, &entry.expected()).is_ok();
        if is_whole {
            whole().insert(entry.file.clone());
        }
        is_whole
    }
}

/// Whether the manifest names the file `name`.
pub(super) fn names(store: &MapStore, name: &str) -> bool {
    SubmapName::parse(name).and_then(|name| store.entry(name.id)).is_some_and(|entry| entry.file == name)
}

/// Removes what a save that failed has written, because it would keep a full disk full. What the manifest that is there names stays, and with
/// a manifest that cannot be read everything does. What cannot be removed is left for the next save.
pub(super) fn remove_unfinished(dir: &Path) {
    let _ = match MapStore::open(dir) {
        Ok(there) => files::remove_others(dir, |name| names(&there, name)),
        Err(_) if !dir.join(MANIFEST).exists() => files::remove_others(dir, |_| false),
        Err(error) => Err(error),
    };
}

/// Everything that the map of `atlas` is made of, ordered by id. A submap that is being fused into another one is still the
/// only place where its part of the map is.
fn pieces(atlas: &Atlas) -> Vec<Piece<'_>> {
    let of_submap = |submap| Piece { submap, t_map_submap: submap.t_map_submap(), session: None };
    let mut pieces: Vec<Piece<'_>> = atlas.submaps().iter().map(of_submap).collect();
    pieces.extend(atlas.merging().map(|r| Piece { submap: r.submap, t_map_submap: r.t_map_submap, session: None }));
    pieces.sort_by_key(|piece| piece.submap.id());
    pieces
}

/// Whether `dir` holds a map; fails when it holds anything that no map writer made.
fn check_is_ours(dir: &Path) -> Result<bool> {
    let names = files::names(dir)?;
    if names.iter().any(|name| name == MANIFEST) {
        return MapStore::open(dir).map(|_| true);
    }
    match names.into_iter().find(|name| name != LOCK && name != UNFINISHED && !files::is_disposable(name)) {
        Some(found) => Err(Error::WouldOverwrite { path: dir.to_owned(), found }),
        None => Ok(false),
    }
}
