//! Repairing a map: a manifest of the submap files that are whole.

use super::additions::sessions::SessionEntry;
use super::description::manifest::{Manifest, SubmapEntry};
use super::description::manifest_text;
use super::description::piece::{MapDetails, Piece};
use super::files::{self, BASE, MANIFEST, SubmapName};
use super::lock::Lock;
use super::reader::MapStore;
use super::sections::submap_file::{self, Found};
use crate::{Error, Result};
use rayon::prelude::*;
use std::collections::{BTreeMap, HashMap};
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::SystemTime;
use voxelastic::atlas::SubmapId;
use voxelastic_files::failpoint;

/// What the names of files that are set aside end with.
const SET_ASIDE: &str = ".damaged";

/// How the manifest was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ManifestState {
    /// Undamaged.
    Whole,
    /// Missing or damaged: made again from the submap files. Corrections of poses since each file was written are lost.
    Rebuilt,
}

/// What [`repair`] did.
#[derive(Debug)]
#[non_exhaustive]
pub struct RepairReport {
    /// How the manifest was found.
    pub manifest: ManifestState,
    /// Submaps in the map now.
    pub submaps: usize,
    /// Scans in the map now.
    pub scans: usize,
    /// What is wrong with each submap file that is not in the map any more, ordered by name.
    pub damage: Vec<Error>,
    /// Files that were renamed, because they are damaged: their present paths.
    pub set_aside: Vec<PathBuf>,
}

/// Makes a map that opens of the damaged one at `path`: a manifest that is missing or damaged is made again from the submap files, and submaps that
/// are damaged leave the map. Damaged files are renamed, not removed. A map without damage is not changed.
///
/// # Errors
/// [`Error::NotAMap`] when there is no submap file that can be read, or that says where its submap lies, [`Error::OtherVersion`], [`Error::Edited`],
/// [`Error::Locked`], and [`Error::Io`].
pub fn repair(path: impl AsRef<Path>) -> Result<RepairReport> {
    let dir = path.as_ref();
    let names = if dir.is_dir() { files::names(dir)? } else { Vec::new() };
    let submap_files: Vec<&String> = names.iter().filter(|name| SubmapName::parse(name).is_some()).collect();
    if submap_files.is_empty() && !names.iter().any(|name| name == MANIFEST) {
        return Err(Error::NotAMap { path: dir.to_owned(), reason: "it has no manifest and no submap files" });
    }
    let _lock = Lock::take(dir)?;
    match MapStore::open(dir) {
        Ok(store) => {
            store.check_unedited()?;
            drop_damaged(&store)
        }
        // The manifest of before the edits is there.
        Err(Error::Damaged { .. } | Error::NotAMap { .. }) if dir.join(BASE).exists() && MapStore::open_base(dir).is_ok() => {
            Err(Error::Edited { path: dir.to_owned() })
        }
        Err(Error::Damaged { .. } | Error::NotAMap { .. }) => rebuild(dir, &submap_files),
        Err(other) => Err(other),
    }
}

/// Renames the map directory `from`, damaged or not, to `to`, unless another process writes it.
///
/// # Errors
/// [`Error::Locked`], and [`Error::Io`].
pub fn move_map(from: impl AsRef<Path>, to: impl AsRef<Path>) -> Result<()> {
    let _lock = Lock::take(from.as_ref())?;
    fs::rename(from.as_ref(), to).map_err(Error::on_io("rename", from.as_ref()))
}

/// Takes the submaps whose files are missing or damaged out of the map.
fn drop_damaged(store: &MapStore) -> Result<RepairReport> {
    let dir = store.dir();
    let check = |entry: &SubmapEntry| submap_file::read(&dir.join(&entry.file), &entry.expected(), false).err();
    let checked: Vec<Option<Error>> = store.manifest().submaps.par_iter().map(check).collect();
    let mut manifest = store.manifest().clone();
    let mut is_whole = checked.iter().map(Option::is_none);
    manifest.submaps.retain(|_| is_whole.next().unwrap_or(false));
    let damage: Vec<Error> = checked.into_iter().flatten().collect();
    // A disk that cannot be read for a moment is no reason to take a submap out.
    if let Some(at) = damage.iter().position(|error| !is_damage(error)) {
        return Err(damage.into_iter().nth(at).unwrap_or(Error::NotAMap { path: dir.to_owned(), reason: "it cannot be read" }));
    }
    finish(dir, ManifestState::Whole, &manifest, damage)
}

/// Makes the manifest again from the submap files that are whole.
fn rebuild(dir: &Path, names: &[&String]) -> Result<RepairReport> {
    let read = |name: &&String| (dir.join(name.as_str()), submap_file::read_alone(&dir.join(name.as_str())));
    let found: Vec<(PathBuf, Result<Found>)> = names.par_iter().map(read).collect();
    let mut session_of = BTreeMap::new();
    let (mut damage, mut best, mut newest) = (Vec::new(), BTreeMap::<SubmapId, (Rank, SubmapEntry)>::new(), None);
    for (path, found) in found {
        match found.and_then(|found| entry_of(&path, found)) {
            Ok((rank, entry, details, session)) => {
                if newest.as_ref().is_none_or(|(other, _)| *other < rank.written) {
                    newest = Some((rank.written, details));
                }
                match best.get(&entry.id) {
                    // A save that was killed leaves two files of a submap: both are whole, the later has more in it.
                    Some((other, _)) if *other > rank => {}
                    _ => {
                        session_of.insert(entry.id, session);
                        best.insert(entry.id, (rank, entry));
                    }
                }
            }
            Err(error) if is_damage(&error) => damage.push(error),
            Err(error) => return Err(error),
        }
    }
    let Some((_, details)) = newest else {
        let unusable = Error::NotAMap { path: dir.to_owned(), reason: "none of its submap files is whole and says where its submap lies" };
        return Err(damage.into_iter().next().unwrap_or(unusable));
    };
    let mut submaps: Vec<SubmapEntry> = best.into_values().map(|(_, entry)| entry).collect();
    remove_fused(&mut submaps);
    let sessions = sessions(&submaps, session_of);
    let manifest = Manifest { details, sessions, submaps, edits: None };
    finish(dir, ManifestState::Rebuilt, &manifest, damage)
}

/// The sessions of a map of these submaps, as their files have it; none if it began with all of them.
fn sessions(submaps: &[SubmapEntry], mut session_of: BTreeMap<SubmapId, Option<SessionEntry>>) -> Vec<SessionEntry> {
    let mut sessions = BTreeMap::new();
    let mut began_with = Vec::new();
    for entry in submaps {
        match session_of.remove(&entry.id).flatten() {
            Some(session) => drop(sessions.entry(session.number).or_insert(session)),
            None => began_with.push(entry.clone()),
        }
    }
    if sessions.is_empty() {
        return Vec::new();
    }
    let first = Manifest { submaps: began_with, ..Manifest::default() };
    first.all_sessions().into_iter().chain(sessions.into_values()).collect()
}

/// Removes submaps whose scans are all in a larger one: they were fused into it, and a save that was killed left their files.
fn remove_fused(submaps: &mut Vec<SubmapEntry>) {
    let mut largest_with = HashMap::new();
    for entry in submaps.iter() {
        for scan in &entry.scans {
            let size = (entry.scans.len(), entry.id);
            largest_with.entry(scan.node).and_modify(|other: &mut (usize, SubmapId)| *other = size.max(*other)).or_insert(size);
        }
    }
    let is_elsewhere = |entry: &SubmapEntry| {
        let mut homes = entry.scans.iter().filter_map(|scan| largest_with.get(&scan.node));
        !entry.scans.is_empty() && homes.all(|(_, id)| *id != entry.id)
    };
    submaps.retain(|entry| !is_elsewhere(entry));
}

/// Which of two files of the same submap is the better one: the one with more scans, then the later.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Rank {
    scans: usize,
    written: SystemTime,
}

/// The entry of a file in the manifest, how its map was made, and the session that it was added with.
fn entry_of(path: &Path, found: Found) -> Result<(Rank, SubmapEntry, MapDetails, Option<SessionEntry>)> {
    let name = path.file_name().and_then(|name| SubmapName::parse(&name.to_string_lossy())).filter(|name| name.id == found.id);
    let name = name.ok_or_else(|| Error::damaged(path, "header", 12, format!("it is submap {}, its name says otherwise", found.id)))?;
    let origin = found.origin;
    let details = origin.details();
    let voxel_size = Manifest { details: details.clone(), ..Manifest::default() }.voxel_size();
    let voxel_size = voxel_size.map_err(|what| Error::damaged(path, "origin section", 0, what))?;
    let written = fs::metadata(path).and_then(|m| m.modified()).unwrap_or(SystemTime::UNIX_EPOCH);
    let rank = Rank { scans: origin.scans.len(), written };
    let submap = origin.submap(found.id, voxel_size, found.fields.tsdf, found.fields.occupancy);
    let piece = Piece { submap: &submap, t_map_submap: origin.t_map_submap, session: None };
    Ok((rank, SubmapEntry::new(&piece, name, found.written), details, origin.session))
}

/// Whether an error says that a file is not what was written, and not that it cannot be read now.
fn is_damage(error: &Error) -> bool {
    matches!(error, Error::Damaged { .. } | Error::Missing { .. })
}

/// Writes the manifest and sets damaged files aside, if anything is to be changed.
fn finish(dir: &Path, state: ManifestState, manifest: &Manifest, damage: Vec<Error>) -> Result<RepairReport> {
    let mut set_aside = Vec::new();
    if state == ManifestState::Rebuilt || !damage.is_empty() {
        let path = dir.join(MANIFEST);
        if state == ManifestState::Rebuilt && path.is_file() {
            let aside = aside(&path);
            failpoint::check("copy", &aside).and_then(|()| fs::copy(&path, &aside)).map_err(|source| {
                // Half of a copy is of no use to anybody.
                let _ = fs::remove_file(&aside);
                Error::on_io("write", &aside)(source)
            })?;
            set_aside.push(aside);
        }
        let text = manifest_text::write(manifest).map_err(|e| Error::on_io("write", &path)(e.into()))?;
        files::write_atomically(dir, MANIFEST, |file| file.write_all(text.as_bytes()))?;
        for path in damage.iter().map(Error::path).filter(|path| path.is_file()) {
            let aside = aside(path);
            failpoint::check("rename", path).and_then(|()| fs::rename(path, &aside)).map_err(Error::on_io("rename", path))?;
            set_aside.push(aside);
        }
        files::sync_dir(dir)?;
    }
    let scans = manifest.submaps.iter().map(|entry| entry.scans.len()).sum();
    Ok(RepairReport { manifest: state, submaps: manifest.submaps.len(), scans, damage, set_aside })
}

/// A path beside `path` that is free and that no map writer removes.
fn aside(path: &Path) -> PathBuf {
    let named = |number: usize| {
        let mut name = path.as_os_str().to_owned();
        name.push(if number == 1 { SET_ASIDE.to_owned() } else { format!("-{number}{SET_ASIDE}") });
        PathBuf::from(name)
    };
    (1..).map(named).find(|path| fs::symlink_metadata(path).is_err()).unwrap_or_else(|| named(1))
}
