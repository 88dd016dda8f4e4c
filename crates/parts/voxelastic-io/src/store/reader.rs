//! Reading a map directory.

use super::description::manifest::{Manifest, SubmapEntry};
use super::description::manifest_text;
use super::files::{self, BASE, MANIFEST, RUN_LOG, UNFINISHED};
use super::sections::submap_file;
use crate::{Error, Result};
use rayon::prelude::*;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use voxelastic::atlas::{Atlas, Submap, SubmapId};

/// A stored map. Opening reads the manifest only.
///
/// Reading takes no lock: a map may be read while it is saved again. A submap that was replaced meanwhile is
/// [`Error::Missing`]; open the map again.
#[derive(Clone, Debug)]
pub struct MapStore {
    dir: PathBuf,
    manifest: Manifest,
    /// Whether occupancy is left out of submaps that have a TSDF.
    is_for_surfaces: bool,
}

impl MapStore {
    /// Opens the map directory `path`.
    ///
    /// # Errors
    /// [`Error::NotAMap`] when something else or nothing is there, [`Error::OtherVersion`], [`Error::Damaged`], and
    /// [`Error::Io`] when the manifest may not be read.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let dir = path.as_ref();
        let not_a_map = |reason| Error::NotAMap { path: dir.to_owned(), reason };
        match dir.metadata() {
            Err(e) if e.kind() == ErrorKind::NotFound => return Err(not_a_map("there is nothing of this name")),
            Err(e) => return Err(Error::on_io("open", dir)(e)),
            Ok(metadata) if !metadata.is_dir() => return Err(not_a_map("it is a file; a map is a directory with a manifest.json")),
            Ok(_) => {}
        }
        let path = dir.join(MANIFEST);
        let text = match files::read(&path, None) {
            Err(Error::Missing { .. }) if dir.join(UNFINISHED).join(MANIFEST).exists() => {
                let reason = "its run has not ended; the folder `unfinished` in it is a map of what was stored last";
                return Err(not_a_map(reason));
            }
            Err(Error::Missing { .. }) => return Err(not_a_map("it has no manifest.json; if it was being mapped, nothing was saved yet")),
            other => other?,
        };
        Ok(Self { dir: dir.to_owned(), manifest: manifest_text::read(&path, &text)?, is_for_surfaces: false })
    }

    /// Opens the map of before its edits.
    pub(super) fn open_base(dir: &Path) -> Result<Self> {
        let path = dir.join(BASE);
        let text = files::read(&path, None)?;
        Ok(Self { dir: dir.to_owned(), manifest: manifest_text::read(&path, &text)?, is_for_surfaces: false })
    }

    /// The map of before its edits, which is this one if it has none. Takes no lock: somebody may be editing it.
    ///
    /// # Errors
    /// As for [`open`](Self::open).
    pub fn before_edits(&self) -> Result<Self> {
        if self.manifest.edits.is_some() { Self::open_base(&self.dir) } else { Ok(self.clone()) }
    }

    /// Refuses a map with edits, which whoever writes it would lose.
    pub(super) fn check_unedited(&self) -> Result<()> {
        match self.manifest.edits {
            Some(_) => Err(Error::Edited { path: self.dir.clone() }),
            None => Ok(()),
        }
    }

    /// The same map for those who need its surfaces only: submaps that have a TSDF are loaded without their occupancy, which takes most of the time and memory. Files are
    /// checked as a whole all the same.
    #[must_use]
    pub fn for_surfaces(self) -> Self {
        Self { is_for_surfaces: true, ..self }
    }

    /// A map without anything, not yet written.
    pub(super) fn empty(dir: &Path) -> Self {
        Self { dir: dir.to_owned(), manifest: Manifest::default(), is_for_surfaces: false }
    }

    pub(super) fn set_manifest(&mut self, manifest: Manifest) {
        self.manifest = manifest;
    }

    pub(super) fn forget_scans(&mut self) {
        self.manifest.submaps.iter_mut().for_each(|entry| (entry.scans, entry.corrected) = (Vec::new(), Vec::new()));
    }

    /// The directory.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// What the map is made of.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// The log of the run that made the map, as it was written; none where there is none.
    ///
    /// # Errors
    /// [`Error::Io`] when it may not be read, [`Error::Damaged`] when it is not text.
    pub fn run_log(&self) -> Result<Option<String>> {
        let path = self.dir.join(RUN_LOG);
        let bytes = match files::read(&path, None) {
            Err(Error::Missing { .. }) => return Ok(None),
            other => other?,
        };
        let not_text = |e: std::string::FromUtf8Error| Error::damaged(&path, "text", e.utf8_error().valid_up_to() as u64, "it is not UTF-8");
        String::from_utf8(bytes).map(Some).map_err(not_text)
    }

    /// Size of the submap files, bytes.
    pub fn bytes(&self) -> u64 {
        self.manifest.submaps.iter().map(|entry| entry.bytes).sum()
    }

    /// The manifest's entry for submap `id`.
    pub fn entry(&self, id: SubmapId) -> Option<&SubmapEntry> {
        self.manifest.submaps.binary_search_by_key(&id, |entry| entry.id).ok().map(|i| &self.manifest.submaps[i])
    }

    /// Loads submap `id`.
    ///
    /// # Errors
    /// [`Error::NoSuchSubmap`]; [`Error::Missing`], [`Error::Damaged`], [`Error::OtherVersion`],
    /// [`Error::UnknownSection`] and [`Error::Io`] for its file.
    pub fn load_submap(&self, id: SubmapId) -> Result<Submap> {
        self.entry(id).ok_or_else(|| Error::NoSuchSubmap { path: self.dir.clone(), id }).and_then(|entry| self.load(entry))
    }

    fn load(&self, entry: &SubmapEntry) -> Result<Submap> {
        let fields = submap_file::read(&self.dir.join(&entry.file), &entry.expected(), self.is_for_surfaces)?;
        Ok(entry.submap(fields, self.voxel_size()?))
    }

    /// Loads all submaps.
    ///
    /// # Errors
    /// As for [`load_submap`](Self::load_submap), for the first submap that cannot be loaded.
    pub fn load_atlas(&self) -> Result<Atlas> {
        let submaps: Vec<Result<Submap>> = self.manifest.submaps.par_iter().map(|entry| self.load(entry)).collect();
        self.atlas_of(submaps.into_iter().collect::<Result<_>>()?)
    }

    /// Loads the submaps that can be loaded, and says what is wrong with the others, ordered by submap.
    ///
    /// # Errors
    /// That of the first submap, when none can be loaded.
    pub fn load_undamaged(&self) -> Result<(Atlas, Vec<Error>)> {
        let submaps: Vec<Result<Submap>> = self.manifest.submaps.par_iter().map(|entry| self.load(entry)).collect();
        let (mut whole, mut damage) = (Vec::new(), Vec::new());
        for submap in submaps {
            match submap {
                Ok(submap) => whole.push(submap),
                Err(error) => damage.push(error),
            }
        }
        match damage.is_empty() || !whole.is_empty() {
            true => Ok((self.atlas_of(whole)?, damage)),
            false => Err(damage.swap_remove(0)),
        }
    }

    fn atlas_of(&self, submaps: Vec<Submap>) -> Result<Atlas> {
        Ok(Atlas::from_submaps(self.voxel_size()?, submaps))
    }

    fn voxel_size(&self) -> Result<f32> {
        self.manifest.voxel_size().map_err(|what| Error::damaged(&self.dir.join(MANIFEST), "settings", 0, what))
    }

    /// What is wrong with the submap files by their sizes alone, ordered by submap: missing ones, and others than were written.
    pub fn check_sizes(&self) -> Vec<Error> {
        self.manifest.submaps.iter().filter_map(|entry| files::check_size(&self.dir.join(&entry.file), entry.bytes).err()).collect()
    }

    /// Checks every submap file against its checksums and returns what is wrong, ordered by submap.
    pub fn check(&self) -> Vec<Error> {
        self.manifest.submaps.par_iter().filter_map(|entry| submap_file::check(&self.dir.join(&entry.file), &entry.expected()).err()).collect()
    }
}
