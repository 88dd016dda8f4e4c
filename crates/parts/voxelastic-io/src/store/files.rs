//! Files in a map directory: their names, and writing them so that they are there wholly or not at all.

use crate::{Error, Result};
use std::fmt;
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::Path;
use voxelastic::atlas::SubmapId;
use voxelastic_files::failpoint::{self, Writes};
use voxelastic_files::patiently;

/// Name of the manifest.
pub(super) const MANIFEST: &str = "manifest.json";
/// Name of the file that a writer holds locked. It stays when the writer goes: removing it would race with the next.
pub(super) const LOCK: &str = ".lock";

/// Name of the file that tells how the map came to be; for people and reports, no part of the map.
pub(super) const RUN_LOG: &str = "run.json";

/// Name of the list of the edits that the map is shown with.
pub(super) const EDITS: &str = "edits.toml";
/// The first line of every list of edits.
pub(super) const EDITS_HEADER: &str =
    "# Edits of this map, in order. Kept by `voxelastic edit`: changed otherwise, they are no longer those of the map.\n";
/// Name of the manifest of before the edits.
pub(super) const BASE: &str = "base.json";

/// Name of the folder in a map directory that has the map of an unfinished run.
pub(super) const UNFINISHED: &str = "unfinished";

/// Name of the file with the state of an unfinished run whose manifest has this checksum.
pub(super) fn state_name(manifest_crc32: u32) -> String {
    format!("state-{manifest_crc32:08x}.vxr")
}

/// Name of the file with the journal of an unfinished run that has this number.
pub(super) fn journal_name(number: u32) -> String {
    format!("journal-{number:08x}.vxj")
}

/// Whether [`journal_name`] makes such names.
pub(super) fn is_journal_name(name: &str) -> bool {
    is_numbered(name, "journal-", ".vxj", journal_name)
}

/// Whether [`state_name`] makes such names.
fn is_state_name(name: &str) -> bool {
    is_numbered(name, "state-", ".vxr", state_name)
}

fn is_numbered(name: &str, before: &str, after: &str, made: fn(u32) -> String) -> bool {
    let digits = name.strip_prefix(before).and_then(|rest| rest.strip_suffix(after));
    digits.and_then(|digits| u32::from_str_radix(digits, 16).ok()).is_some_and(|number| made(number) == name)
}

/// Name of a submap file: the same name is always the same content.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct SubmapName {
    pub id: SubmapId,
    pub digest: u64,
}

impl fmt::Display for SubmapName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "submap-{:06}-{:016x}.vxs", self.id, self.digest)
    }
}

impl SubmapName {
    /// The name of the file of a submap of which nothing was hashed so far.
    pub fn unhashed(id: SubmapId) -> Self {
        Self { id, digest: 0 }
    }

    /// Reads a name; anything that is not exactly what [`Display`](fmt::Display) writes is no name. So no path to elsewhere is one.
    pub fn parse(name: &str) -> Option<Self> {
        let (id, digest) = name.strip_prefix("submap-")?.strip_suffix(".vxs")?.split_once('-')?;
        let parsed = Self { id: id.parse().ok()?, digest: u64::from_str_radix(digest, 16).ok()? };
        (parsed.to_string() == name).then_some(parsed)
    }
}

/// Name under which `name` is written before it is complete.
fn temporary(name: &str) -> String {
    format!(".{name}.tmp")
}

/// Whether a map writer makes files of this name that may be removed when no manifest names them.
pub(super) fn is_disposable(name: &str) -> bool {
    let whole = name.strip_prefix('.').and_then(|n| n.strip_suffix(".tmp"));
    let bare = whole.unwrap_or(name);
    SubmapName::parse(bare).is_some() || is_state_name(bare) || is_journal_name(bare) || [MANIFEST, RUN_LOG, EDITS, BASE].map(Some).contains(&whole)
}

/// Writes a file of `name` in `dir` through `fill`: under another name first, made durable, then renamed.
pub(super) fn write_atomically<T>(dir: &Path, name: &str, fill: impl FnOnce(&mut Writes<'_>) -> io::Result<T>) -> Result<T> {
    write_and_name(dir, name, |file| fill(file).map(|value| (name.to_owned(), value)))
}

/// As [`write_atomically`], for a file whose name `fill` returns, because it follows from the content. Errors call it `meanwhile`.
pub(super) fn write_and_name<T>(dir: &Path, meanwhile: &str, fill: impl FnOnce(&mut Writes<'_>) -> io::Result<(String, T)>) -> Result<T> {
    let (path, temporary) = (dir.join(meanwhile), dir.join(temporary(meanwhile)));
    let write = || {
        // What a killed writer left is removed and not opened: where others may write, it could be a link to a file elsewhere.
        if let Err(error) = fs::remove_file(&temporary)
            && error.kind() != io::ErrorKind::NotFound
        {
            return Err(error);
        }
        failpoint::check("create", &path)?;
        let mut file = Writes::new(patiently(|| File::options().write(true).create_new(true).open(&temporary))?, &path);
        let (name, value) = fill(&mut file)?;
        file.sync_all()?;
        drop(file);
        failpoint::check("rename", &path)?;
        fs::rename(&temporary, dir.join(name))?;
        Ok(value)
    };
    write().map_err(|source| {
        // The half-written file only takes space, often the very space that ran out; the error to report is the first.
        let _ = failpoint::check("remove", &temporary).and_then(|()| fs::remove_file(&temporary));
        Error::on_io("write", &path)(source)
    })
}

/// Gives the durable file `from` the second name `to`. `false` if the file system cannot; nothing is at `to` then.
pub(super) fn link(from: &Path, to: &Path) -> bool {
    // What is there is of no manifest, or damaged.
    let _ = fs::remove_file(to);
    failpoint::check("link", to).and_then(|()| fs::hard_link(from, to)).is_ok()
}

/// Makes renames in `dir` durable.
pub(super) fn sync_dir(dir: &Path) -> Result<()> {
    // Elsewhere directories cannot be opened as files, and renames are durable by the file system's own means.
    if cfg!(unix) {
        let sync = || failpoint::check("make durable", dir).and_then(|()| File::open(dir)?.sync_all());
        sync().map_err(Error::on_io("make durable", dir))?;
    }
    Ok(())
}

/// Checks that a regular file of `expected` bytes is at `path`.
pub(super) fn check_size(path: &Path, expected: u64) -> Result<()> {
    size(path, Some(expected)).map(drop)
}

/// Size of the regular file at `path`, which is `expected` if that is known.
fn size(path: &Path, expected: Option<u64>) -> Result<u64> {
    let metadata = match failpoint::check("look at", path).and_then(|()| fs::metadata(path)) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Err(Error::Missing { path: path.to_owned() }),
        other => other.map_err(Error::on_io("read", path))?,
    };
    // Opening anything else, a pipe for one, could wait forever.
    if !metadata.is_file() {
        return Err(Error::damaged(path, "length", 0, "it is not a regular file"));
    }
    match expected {
        Some(expected) if metadata.len() != expected => Err(wrong_size(path, metadata.len(), expected)),
        _ => Ok(metadata.len()),
    }
}

fn wrong_size(path: &Path, length: u64, expected: u64) -> Error {
    Error::damaged(path, "length", length.min(expected), format!("it has {length} bytes instead of {expected}"))
}

/// Reads the file at `path`, which has `expected` bytes if that is known.
pub(super) fn read(path: &Path, expected: Option<u64>) -> Result<Vec<u8>> {
    let length = size(path, expected)?;
    let too_large = || Error::OutOfMemory { path: path.to_owned(), bytes: length };
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(usize::try_from(length).map_err(|_| too_large())?).map_err(|_| too_large())?;
    let read = || {
        bytes.clear();
        failpoint::check("read", path).and_then(|()| File::open(path)?.take(length).read_to_end(&mut bytes))
    };
    patiently(read).map_err(Error::on_io("read", path))?;
    if bytes.len() as u64 != length { Err(wrong_size(path, bytes.len() as u64, length)) } else { Ok(bytes) }
}

/// Names of everything in `dir`, sorted.
pub(super) fn names(dir: &Path) -> Result<Vec<String>> {
    let entries = failpoint::check("list", dir).and_then(|()| fs::read_dir(dir)?.collect::<io::Result<Vec<_>>>());
    let mut names: Vec<String> =
        entries.map_err(Error::on_io("list", dir))?.iter().map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    Ok(names)
}

/// Removes regular files of our own naming that `keep` does not want, and returns how many. What cannot be removed is
/// left for the next time.
pub(super) fn remove_others(dir: &Path, keep: impl Fn(&str) -> bool) -> Result<usize> {
    let mut removed = 0;
    for name in names(dir)?.iter().filter(|name| is_disposable(name) && !keep(name)) {
        let path = dir.join(name);
        if !fs::symlink_metadata(&path).is_ok_and(|m| m.is_file()) {
            continue;
        }
        match failpoint::check("remove", &path).and_then(|()| fs::remove_file(&path)) {
            Ok(()) => removed += 1,
            Err(error) => tracing::warn!(path = %path.display(), %error, "cannot remove a file that the map no longer needs"),
        }
    }
    Ok(removed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn names_come_back(id in any::<u32>(), digest in any::<u64>()) {
            let name = SubmapName { id, digest };
            prop_assert_eq!(SubmapName::parse(&name.to_string()), Some(name));
            let temporary = temporary(&name.to_string());
            prop_assert!(is_disposable(&temporary) && is_disposable(&name.to_string()) && SubmapName::parse(&temporary).is_none());
        }
    }

    #[cfg(unix)]
    #[test]
    fn a_temporary_that_is_a_link_is_replaced_and_not_followed() {
        let dir = tempfile::tempdir().unwrap();
        let victim = dir.path().join("victim");
        fs::write(&victim, "precious").unwrap();
        std::os::unix::fs::symlink(&victim, dir.path().join(temporary(MANIFEST))).unwrap();
        write_atomically(dir.path(), MANIFEST, |file| io::Write::write_all(file, b"new")).unwrap();
        assert_eq!(fs::read(&victim).unwrap(), b"precious");
        assert!(fs::symlink_metadata(dir.path().join(MANIFEST)).unwrap().is_file());
    }

    #[test]
    fn other_peoples_files_are_not_ours() {
        for name in [
            "manifest.json",
            ".lock",
            "notes.txt",
            "submap-000001.vxs",
            "submap-1-00000000000000aa.vxs",
            "submap-000001-AA.vxs",
            "submap-000001-00000000000000AA.vxs",
            "../submap-000001-00000000000000aa.vxs",
            "submap-+00001-00000000000000aa.vxs",
            ".submap-000001-00000000000000aa.vxs",
            "submap-000001-00000000000000aa.vxs.tmp",
            ".notes.tmp",
        ] {
            assert!(!is_disposable(name), "{name}");
        }
        assert!(is_disposable(".manifest.json.tmp"));
    }
}
