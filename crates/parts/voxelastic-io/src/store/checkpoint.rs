//! Checkpoints of a run: a map of what is mapped so far, and the state of the run, from which another process goes on.
//!
//! They are in the folder `unfinished` of the map directory, which is a map directory itself: whatever reads maps reads it. Beside its manifest
//! lies the state, in a file whose name has the checksum of the manifest, and the journal. Journal and state are written first, and the manifest is
//! replaced last, so that a process that dies at any moment leaves the checkpoint before or the new one.
//!
//! The state file: magic (8 bytes), version (u32), length of the table (u64), the table, the state, and the CRC-32 of all before (u32), little
//! endian. The table is JSON: the root pose that each submap had when its file was written, because the file has a copy of it, and name and length
//! of the journal. State and records of the journal are the caller's: the state is what is small, the journal what grows with the run.

use super::description::manifest::SubmapEntry;
use super::description::piece::{MapDetails, Piece};
use super::description::pose_as_numbers;
use super::files::{self, LOCK, MANIFEST, RUN_LOG, SubmapName, UNFINISHED, state_name};
use super::journal::{self, Journal};
use super::known_file::KnownFile;
use super::lock::Lock;
use super::reader::MapStore;
use super::sections::bytes::Bytes;
use super::sections::submap_file::Written;
use super::writer::{MapWriter, SaveReport, names};
use crate::{Error, Result};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use voxelastic::Pose;
use voxelastic::atlas::{Atlas, Submap, SubmapId};

const MAGIC: [u8; 8] = *b"\x89VXRUN\r\n";
const VERSION: u32 = 3;
/// Bytes before the table.
const HEAD: usize = 20;

/// Writes checkpoints of one run into a map directory.
#[derive(Debug)]
pub struct Checkpoints {
    dir: PathBuf,
    writer: MapWriter,
    rows: HashMap<SubmapId, Row>,
    journal: Journal,
    /// Name of the state file of the checkpoint that is there.
    state: Option<String>,
}

/// What a checkpoint has of a submap.
#[derive(Clone, Copy, Debug)]
struct Row {
    /// Of the submap in memory that is the one in the file.
    revision: u64,
    name: SubmapName,
    written: Written,
    /// Its root pose when the file was written.
    t_map_submap: Pose,
}

/// What was stored of an unfinished run.
#[derive(Debug)]
#[non_exhaustive]
pub struct Checkpoint {
    /// The submaps.
    pub atlas: Atlas,
    /// How the map is made.
    pub details: MapDetails,
    /// The state of the run, as it was given.
    pub state: Vec<u8>,
    /// The records of the journal.
    pub records: Vec<Vec<u8>>,
}

/// The state file's table.
#[derive(Default, Serialize, Deserialize)]
struct StoredTable {
    submaps: Vec<StoredRow>,
    /// Name of the journal, and how many bytes of it belong to the checkpoint.
    journal: (String, u64),
}

/// A row of the state file's table.
#[derive(Serialize, Deserialize)]
struct StoredRow {
    id: SubmapId,
    #[serde(with = "pose_as_numbers")]
    t_map_submap: Pose,
}

impl Checkpoints {
    /// Begins the checkpoints of a run whose map `writer` will save. The first one replaces those of an earlier run.
    ///
    /// # Errors
    /// [`Error::Locked`], and [`Error::Io`] when the folder cannot be made.
    pub fn begin(writer: &MapWriter) -> Result<Self> {
        let dir = writer.store().dir().join(UNFINISHED);
        // A manifest that cannot be read is no reason to fail: it is replaced.
        if matches!(MapStore::open(&dir), Err(Error::Damaged { .. } | Error::OtherVersion { .. })) {
            discard(&dir);
        }
        let writer = MapWriter::create(&dir)?;
        let journal = Journal::new(journal::new_path(&dir));
        let state = files::read(&dir.join(MANIFEST), None).ok().map(|text| state_name(crc32fast::hash(&text)));
        Ok(Self { writer, dir, rows: HashMap::new(), journal, state })
    }

    /// Removes the checkpoint of a run that nobody wants to go on with, if there is one.
    ///
    /// # Errors
    /// [`Error::Locked`] when the run is under way.
    pub fn remove(writer: &MapWriter) -> Result<()> {
        let dir = writer.store().dir().join(UNFINISHED);
        if dir.is_dir() {
            let _lock = Lock::take(&dir)?;
            discard(&dir);
        }
        Ok(())
    }

    /// Adds a record to the journal. It is kept from the next checkpoint on.
    pub fn record(&mut self, record: &[u8]) {
        self.journal.add(record);
    }

    /// Whether the map directory has a checkpoint of a run that did not end, or seems to.
    pub fn is_there(writer: &MapWriter) -> bool {
        writer.store().dir().join(UNFINISHED).join(MANIFEST).exists()
    }

    /// Moves the checkpoint in the directory of the map that `writer` will save to `path`, where it is a map of its own.
    ///
    /// # Errors
    /// [`Error::Locked`] when the run is under way, and [`Error::Io`].
    pub fn move_to(writer: &MapWriter, path: impl AsRef<Path>) -> Result<()> {
        let dir = writer.store().dir();
        super::repair::move_map(dir.join(UNFINISHED), &path)?;
        files::sync_dir(dir)
    }

    /// The checkpoint in the directory of the map that `writer` will save, and the checkpoints that follow it. None if there is none.
    ///
    /// # Errors
    /// [`Error::Damaged`] and [`Error::OtherVersion`] for a checkpoint that cannot be used, [`Error::Locked`] and [`Error::Io`].
    pub fn resume(writer: &MapWriter) -> Result<Option<(Checkpoint, Self)>> {
        if !Self::is_there(writer) {
            return Ok(None);
        }
        let dir = writer.store().dir().join(UNFINISHED);
        let writer = MapWriter::create(&dir)?;
        let store = writer.store();
        let text = files::read(&dir.join(MANIFEST), None)?;
        let state_name = state_name(crc32fast::hash(&text));
        let (StoredTable { submaps: poses, journal: (name, length) }, state) = read_state(&dir.join(&state_name))?;
        if !files::is_journal_name(&name) {
            return Err(Error::damaged(&dir.join(&state_name), "journal", 0, format!("{name:?} is not the name of a journal")));
        }
        let (journal, records) = Journal::open(dir.join(name), length)?;
        let atlas = store.load_atlas()?;
        let row = |entry: &SubmapEntry| {
            let name = SubmapName::parse(&entry.file)?;
            let revision = atlas.submap(entry.id).map(Submap::revision)?;
            let t_map_submap = poses.iter().find(|row| row.id == entry.id)?.t_map_submap;
            Some((entry.id, Row { revision, name, written: Written { bytes: entry.bytes, crc32: entry.crc32 }, t_map_submap }))
        };
        let rows = store.manifest().submaps.iter().filter_map(row).collect();
        let details = store.manifest().details.clone();
        Ok(Some((Checkpoint { atlas, details, state, records }, Self { dir, writer, rows, journal, state: Some(state_name) })))
    }

    /// Stores `atlas` and the `state` of the run. The atlas must be that of the last checkpoint, with what came since: submaps whose
    /// [revision](Submap::revision) is the same are not looked at again. When this returns, the checkpoint is durable; when it fails or the
    /// process dies, the one before is there.
    ///
    /// # Errors
    /// As for [`MapWriter::save`].
    pub fn write(&mut self, atlas: &Atlas, details: &MapDetails, state: &[u8]) -> Result<SaveReport> {
        self.write_with(atlas, details, |file| file.write_all(state))
    }

    /// As [`write`](Self::write), with a state that `state` writes, piece by piece: it is never in memory as a whole.
    ///
    /// # Errors
    /// As for [`write`](Self::write), and those of `state`.
    pub fn write_with(&mut self, atlas: &Atlas, details: &MapDetails, state: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<SaveReport> {
        let written = self.write_all(atlas, details, state);
        let Ok(mut report) = written else {
            // What was written takes space, often the very space that ran out. Of journals, an earlier run's may be needed.
            let _ = files::remove_others(&self.dir, |name| self.needs(name) || files::is_journal_name(name));
            return written;
        };
        self.journal.settle();
        files::sync_dir(&self.dir)?;
        report.removed = files::remove_others(&self.dir, |name| self.needs(name))?;
        Ok(report)
    }

    /// Whether the last checkpoint is made of the file `name`, among others.
    fn needs(&self, name: &str) -> bool {
        self.state.as_deref() == Some(name) || self.journal.name() == name || names(self.writer.store(), name)
    }

    fn write_all(&mut self, atlas: &Atlas, details: &MapDetails, state: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<SaveReport> {
        let saved = {
            let known = |piece: &Piece<'_>| self.same_fields(piece.submap);
            self.writer.write_files(atlas, details, known)?
        };
        let mut rows = HashMap::new();
        for (entry, is_new) in &saved {
            let (Some(submap), Some(name)) = (atlas.submap(entry.id), SubmapName::parse(&entry.file)) else { continue };
            let before = self.rows.get(&entry.id).filter(|row| !is_new || row.revision == submap.revision());
            // Of a file of an earlier run nobody knows when it was written.
            let Some(t_map_submap) = before.map(|row| row.t_map_submap).or(is_new.then_some(entry.t_map_submap)) else { continue };
            let written = Written { bytes: entry.bytes, crc32: entry.crc32 };
            rows.insert(entry.id, Row { revision: submap.revision(), name, written, t_map_submap });
        }
        let mut submaps: Vec<StoredRow> = rows.iter().map(|(id, row)| StoredRow { id: *id, t_map_submap: row.t_map_submap }).collect();
        submaps.sort_by_key(|row| row.id);
        self.journal.write()?;
        let table = StoredTable { submaps, journal: (self.journal.name().to_owned(), self.journal.length()) };
        let (dir, mut written) = (&self.dir, None);
        let report = self.writer.commit(saved, details, |text| {
            let name = state_name(crc32fast::hash(text.as_bytes()));
            files::write_atomically(dir, &name, |file| write_state(&table, state, file))?;
            written = Some(name);
            files::sync_dir(dir)
        })?;
        (self.rows, self.state) = (rows, written);
        // They grow with the run, and nobody asks for them here.
        self.writer.forget_scans();
        Ok(report)
    }

    /// The file that has the fields of `submap` already.
    fn same_fields(&self, submap: &Submap) -> Option<KnownFile> {
        let row = self.rows.get(&submap.id()).filter(|row| row.revision == submap.revision())?;
        let path = self.dir.join(row.name.to_string());
        path.is_file().then_some(KnownFile { name: row.name, written: row.written, path })
    }

    /// The file that is what a save of `piece` would write: with the same root pose in it, so that maps do not depend on when their
    /// checkpoints were.
    fn known(&self, piece: &Piece<'_>) -> Option<KnownFile> {
        let bits = |pose: &Pose| (pose.translation.vector.map(f64::to_bits), pose.rotation.coords.map(f64::to_bits));
        let row = self.rows.get(&piece.submap.id())?;
        self.same_fields(piece.submap).filter(|_| bits(&row.t_map_submap) == bits(&piece.t_map_submap))
    }

    /// Saves the map at the end of the run by `writer`, as [`MapWriter::save`] does. Files of submaps that did not change since the last checkpoint
    /// are taken from there.
    ///
    /// # Errors
    /// As for [`MapWriter::save`].
    pub fn save_map(&self, writer: &mut MapWriter, atlas: &Atlas, details: &MapDetails) -> Result<SaveReport> {
        writer.save_with(atlas, details, |piece| self.known(piece))
    }

    /// Whether there is one to go on from: of this run, or of the one that it goes on with.
    pub fn has_any(&self) -> bool {
        self.state.is_some()
    }

    /// Removes the checkpoint, after the map is saved.
    pub fn discard(self) {
        let Self { dir, writer, .. } = self;
        discard(&dir);
        drop(writer);
    }
}

/// Removes all that checkpoints write. What cannot be removed only takes space.
fn discard(dir: &Path) {
    // First, so that nobody goes on with half of a checkpoint.
    let _ = fs::remove_file(dir.join(MANIFEST));
    let _ = files::remove_others(dir, |_| false);
    for name in [RUN_LOG, LOCK] {
        let _ = fs::remove_file(dir.join(name));
    }
    let _ = fs::remove_dir(dir);
}

fn write_state(table: &StoredTable, state: impl FnOnce(&mut dyn Write) -> io::Result<()>, file: &mut impl Write) -> io::Result<()> {
    let table = serde_json::to_vec(table)?;
    let mut out = io::BufWriter::new(Summed { file, crc32: crc32fast::Hasher::new() });
    out.write_all(&MAGIC)?;
    out.write_all(&VERSION.to_le_bytes())?;
    out.write_all(&(table.len() as u64).to_le_bytes())?;
    out.write_all(&table)?;
    state(&mut out)?;
    let Summed { file, crc32 } = out.into_inner().map_err(io::IntoInnerError::into_error)?;
    file.write_all(&crc32.finalize().to_le_bytes())
}

/// A file, and the checksum of what was written into it.
struct Summed<'a, W> {
    file: &'a mut W,
    crc32: crc32fast::Hasher,
}

impl<W: Write> Write for Summed<'_, W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = self.file.write(bytes)?;
        self.crc32.update(&bytes[..count]);
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

fn read_state(path: &Path) -> Result<(StoredTable, Vec<u8>)> {
    let bytes = files::read(path, None)?;
    let damaged = |at: usize, what: String| Error::damaged(path, "state", at as u64, what);
    let (content, crc32) = bytes.split_last_chunk::<4>().ok_or_else(|| damaged(0, "it is shorter than its checksum".to_owned()))?;
    let mut head = Bytes::new(content);
    if head.take(MAGIC.len()) != Ok(&MAGIC[..]) {
        return Err(damaged(0, "it does not start like the state of a run".to_owned()));
    }
    let version = head.u32().map_err(|e| damaged(8, e))?;
    if crc32fast::hash(content) != u32::from_le_bytes(*crc32) {
        return Err(damaged(0, format!("its {} bytes do not match their checksum", bytes.len())));
    }
    if version > VERSION {
        return Err(Error::OtherVersion { path: path.to_owned(), found: version, supported: VERSION });
    } else if version < VERSION {
        return Err(damaged(8, format!("it is of version {version}, which this program does not go on with")));
    }
    let length = head.u64().map_err(|e| damaged(12, e))?;
    let table = usize::try_from(length).map_err(|_| "a table longer than memory".to_owned()).and_then(|length| head.take(length));
    let table = table.map_err(|e| damaged(12, e))?;
    let rows = serde_json::from_slice(table).map_err(|e| damaged(HEAD, e.to_string()))?;
    Ok((rows, content[HEAD + table.len()..].to_vec()))
}
