//! Where the map is saved. A finished map stays in memory until a disk takes it.

use crate::error::During;
use crate::joining::Addition;
use crate::mapping::Mapping;
use crate::warning::{Code, Warnings};
use crate::{Error, Result, map_files, usage};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use voxelastic_io::store::{Checkpoint, Checkpoints, MapDetails, MapStore, MapWriter, SaveReport};
use voxelastic_report::RunLog;

/// First and longest pause between two attempts to save.
const PAUSES: [Duration; 2] = [Duration::from_secs(2), Duration::from_secs(60)];

/// What to do when the finished map cannot be written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum OnFullDisk {
    /// Save it in the current, the home or the temporary folder, whichever has the space; if none has, wait.
    #[default]
    Elsewhere,
    /// Keep it in memory and try again until it fits; after an interrupt try elsewhere.
    Wait,
    /// Give it up.
    Fail,
}

/// How a map is saved.
#[derive(Clone, Copy, Debug, Default)]
pub struct SaveOptions {
    /// Replace an existing map even if it has more scans than the new one.
    pub overwrite: bool,
    /// What to do when the finished map cannot be written, because the disk is full for one.
    pub on_full_disk: OnFullDisk,
    /// Says whether the user wants to wait no longer.
    pub is_stopped: Option<fn() -> bool>,
}

impl SaveOptions {
    fn is_stopped(self) -> bool {
        self.is_stopped.is_some_and(|is_stopped| is_stopped())
    }
}

/// The map directory during the run. A run that fails leaves the directory unchanged.
pub struct Target {
    writer: Option<MapWriter>,
    checkpoints: Option<Checkpoints>,
    path: PathBuf,
    options: SaveOptions,
    elsewhere: bool,
    /// Whether a session is added to the map that is there.
    adds: bool,
    /// Where the session lies in that map.
    addition: Option<Box<Addition>>,
}

impl Target {
    /// Makes the directory and locks it.
    pub fn create(path: &Path, options: SaveOptions, warnings: &mut Warnings) -> Result<Self> {
        set_damaged_aside(path, warnings)?;
        let writer = MapWriter::create(path).during("cannot write the map there")?;
        Ok(Self { writer: Some(writer), checkpoints: None, path: path.to_owned(), options, elsewhere: false, adds: false, addition: None })
    }

    /// Opens a map to add a session to it, and locks it.
    pub fn open(path: &Path, options: SaveOptions) -> Result<Self> {
        map_files::open(path)?;
        let writer = MapWriter::open(path)?;
        Ok(Self { writer: Some(writer), checkpoints: None, path: path.to_owned(), options, elsewhere: false, adds: true, addition: None })
    }

    /// The map that is there.
    pub fn store(&self) -> Result<&MapStore> {
        Ok(self.writer()?.store())
    }

    /// Says where the session lies in the map that is there.
    pub fn set_addition(&mut self, addition: Box<Addition>) {
        self.addition = Some(addition);
    }

    /// Whether a run can go on from a checkpoint.
    pub fn has_checkpoint(&self) -> bool {
        self.checkpoints.as_ref().is_some_and(Checkpoints::has_any)
    }

    /// Saves the session as a map of its own, at the first name like `path` that is free.
    pub fn save_apart(&mut self, mapping: &Mapping, details: &MapDetails, path: &Path, warnings: &mut Warnings) -> Result<SaveReport> {
        let (path, writer) = free_path(path, 1)?;
        self.move_to(path, writer);
        (self.elsewhere, self.adds) = (true, false);
        self.save(mapping, details, warnings)
    }

    /// Where the map is, or will be, saved.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Scans in the map that the run replaces.
    pub fn scans(&self) -> usize {
        self.writer.as_ref().filter(|_| !self.adds).map_or(0, scans_in)
    }

    fn writer(&self) -> Result<&MapWriter> {
        self.writer.as_ref().ok_or_else(abandoned)
    }

    /// What was stored of a run that did not end; its checkpoints are then those of this run.
    pub fn take_checkpoint(&mut self) -> Result<Option<Checkpoint>> {
        let found = Checkpoints::resume(self.writer()?)?;
        Ok(found.map(|(checkpoint, checkpoints)| {
            self.checkpoints = Some(checkpoints);
            checkpoint
        }))
    }

    /// Gives up what was stored of a run that did not end.
    pub fn remove_checkpoints(&mut self) -> Result<()> {
        self.checkpoints = None;
        Ok(Checkpoints::remove(self.writer()?)?)
    }

    /// Makes a map of its own of what was stored of a run that did not end, because this one does not go on with it.
    pub fn set_unfinished_aside(&mut self, warnings: &mut Warnings) -> Result<()> {
        if !Checkpoints::is_there(self.writer()?) {
            return Ok(());
        }
        self.checkpoints = None;
        let aside = free_name(&self.path, "unfinished");
        Checkpoints::move_to(self.writer()?, &aside).during("cannot set the run aside that did not end")?;
        let text = format!("{} has a run that did not end: what it had mapped is the map {} now", self.path.display(), aside.display());
        warnings.add(Code::SetAside, text, "");
        Ok(())
    }

    /// The checkpoints of this run.
    pub fn checkpoints(&mut self) -> Result<&mut Checkpoints> {
        let begun = match self.checkpoints.take() {
            Some(begun) => begun,
            None => Checkpoints::begin(self.writer()?)?,
        };
        Ok(self.checkpoints.insert(begun))
    }

    /// Removes the checkpoints, as the run has ended and its map is saved.
    pub fn discard_checkpoints(&mut self) {
        if let Some(checkpoints) = self.checkpoints.take() {
            checkpoints.discard();
        }
    }

    /// Whether the map is in another folder than the one that was asked for, because that could not be written.
    pub fn is_elsewhere(&self) -> bool {
        self.elsewhere
    }

    /// Saves the map; if the file system refuses, as [`OnFullDisk`] says.
    pub fn save(&mut self, mapping: &Mapping, details: &MapDetails, warnings: &mut Warnings) -> Result<SaveReport> {
        let problem = match self.save_here(mapping, details, warnings) {
            Err(problem) if problem.is_of_the_system() => problem,
            other => return other,
        };
        tracing::error!("{}; the map of {} scans is still in memory", problem.one_line(), mapping.scans());
        match self.options.on_full_disk {
            OnFullDisk::Fail => Err(self.lost(mapping, &[problem])),
            OnFullDisk::Wait => self.wait(mapping, details, warnings),
            OnFullDisk::Elsewhere => match self.save_elsewhere(mapping, details, warnings) {
                Ok(report) => Ok(report),
                Err(problems) => {
                    problems.iter().for_each(|problem| tracing::error!("{}", problem.one_line()));
                    self.wait(mapping, details, warnings)
                }
            },
        }
    }

    /// Tries again until the map is saved. An interrupt ends the waiting: then the map is saved elsewhere or lost.
    fn wait(&mut self, mapping: &Mapping, details: &MapDetails, warnings: &mut Warnings) -> Result<SaveReport> {
        let [mut pause, longest] = PAUSES;
        let (folder, mb) = (self.path.display().to_string(), usage::megabytes(mapping.atlas().bytes() as u64));
        let already = self.options.is_stopped();
        tracing::warn!("the map ({mb:.0} MB) stays in memory, waiting until {folder} can be written: free some space, or interrupt to stop waiting");
        loop {
            let until = Instant::now() + pause;
            while Instant::now() < until {
                if self.options.is_stopped() && !already {
                    return self.save_elsewhere(mapping, details, warnings).map_err(|problems| self.lost(mapping, &problems));
                }
                std::thread::sleep(Duration::from_millis(50));
            }
            match self.save_here(mapping, details, warnings) {
                Err(problem) if problem.is_of_the_system() => tracing::warn!("still waiting: {}", problem.one_line()),
                other => return other,
            }
            pause = longest.min(2 * pause);
        }
    }

    fn save_here(&mut self, mapping: &Mapping, details: &MapDetails, warnings: &mut Warnings) -> Result<SaveReport> {
        if !self.adds {
            self.keep_better(mapping.scans(), warnings)?;
        }
        let writer = self.writer.as_mut().ok_or_else(abandoned)?;
        if let Some(addition) = self.addition.as_ref().filter(|_| self.adds) {
            let saved = mapping.pool().install(|| addition.save(writer, mapping.atlas()));
            return saved.during("cannot add the session to the map, which is as it was before");
        }
        save(writer, self.checkpoints.as_ref(), mapping, details)
    }

    /// Saves the map in the first other folder that takes it; else the problem with each.
    fn save_elsewhere(&mut self, mapping: &Mapping, details: &MapDetails, warnings: &mut Warnings) -> std::result::Result<SaveReport, Vec<Error>> {
        let name = self.path.file_name().map_or_else(|| PathBuf::from("map.vox"), PathBuf::from);
        let mut problems = Vec::new();
        for folder in other_folders(&self.path) {
            let saved = free_path(&folder.join(&name), 1).and_then(|(path, mut writer)| {
                match save(&mut writer, self.checkpoints.as_ref(), mapping, details) {
                    Ok(report) => Ok((path, writer, report)),
                    Err(problem) => {
                        writer.abandon();
                        Err(problem)
                    }
                }
            });
            match saved {
                Ok((path, writer, report)) => {
                    let text = format!("{} could not be written: the map is saved as {}", self.path.display(), path.display());
                    warnings.add(Code::SavedElsewhere, text, "");
                    self.move_to(path, writer);
                    (self.elsewhere, self.adds) = (true, false);
                    return Ok(report);
                }
                Err(problem) => problems.push(problem),
            }
        }
        Err(problems)
    }

    /// Moves on to a path beside it if the map that is there has more scans than the `scans` of this one.
    fn keep_better(&mut self, scans: usize, warnings: &mut Warnings) -> Result<()> {
        let Some(there) = self.writer.as_ref().map(scans_in).filter(|there| !self.options.overwrite && *there > scans) else { return Ok(()) };
        let (path, beside) = free_path(&self.path, 2)?;
        let text = format!("{} has {there} scans and is kept; this map, of {scans}, is saved as {}", self.path.display(), path.display());
        warnings.add(Code::SavedElsewhere, text, "--overwrite replaces a larger map");
        self.move_to(path, beside);
        Ok(())
    }

    /// Removes the folder of checkpoints if none could be written.
    fn discard_if_none(&mut self) {
        if self.checkpoints.as_ref().is_some_and(|checkpoints| !checkpoints.has_any()) {
            self.discard_checkpoints();
        }
    }

    fn move_to(&mut self, path: PathBuf, writer: MapWriter) {
        self.discard_if_none();
        self.path = path;
        if let Some(before) = self.writer.replace(writer) {
            before.abandon();
        }
    }

    /// The error when no disk took the map.
    fn lost(&self, mapping: &Mapping, problems: &[Error]) -> Error {
        let there = self.writer.as_ref().map_or(0, scans_in);
        let old =
            if there > 0 { format!("{} is the map of {there} scans that was there before", self.path.display()) } else { "it is nowhere".into() };
        let problems: Vec<String> = problems.iter().map(Error::one_line).collect();
        let message = format!("the map of {} scans is lost, {old}: {}", mapping.scans(), problems.join("; "));
        Error::new(message, "free some space and map again, or name another disk with -o; --on-full-disk wait keeps the map in memory")
    }

    /// Saves the log of the run with the map. A problem is a warning.
    pub fn log(&mut self, log: &RunLog, warnings: &mut Warnings) {
        let Some(writer) = &mut self.writer else { return };
        let written = log.to_json().map_err(Error::from).and_then(|text| Ok(writer.write_run_log(&text)?));
        if let Err(problem) = written {
            let text = format!("the log of the run is not saved, so reports will have no charts of it: {}", problem.one_line());
            warnings.add(Code::NoLog, text, "");
        }
    }
}

fn abandoned() -> Error {
    Error::new("the map was abandoned before it was saved", "")
}

impl Drop for Target {
    fn drop(&mut self) {
        self.discard_if_none();
        if let Some(writer) = self.writer.take() {
            writer.abandon();
        }
    }
}

/// Renames a map at `path` that does not open, so that its name is free and what is whole in it can still be repaired.
fn set_damaged_aside(path: &Path, warnings: &mut Warnings) -> Result<()> {
    let error = match MapStore::open(path) {
        Err(error @ (voxelastic_io::Error::Damaged { .. } | voxelastic_io::Error::NotAMap { .. })) if map_files::has_submap_files(path) => error,
        _ => return Ok(()),
    };
    let aside = free_name(path, "damaged");
    voxelastic_io::store::move_map(path, &aside).during("cannot set the damaged map aside")?;
    let text = format!("{error}; the damaged map is set aside as {}", aside.display());
    warnings.add(Code::SetAside, text, format!("`voxelastic repair {}` makes the best of it", aside.display()));
    Ok(())
}

fn save(writer: &mut MapWriter, checkpoints: Option<&Checkpoints>, mapping: &Mapping, details: &MapDetails) -> Result<SaveReport> {
    let atlas = mapping.atlas();
    let save = || match checkpoints {
        Some(checkpoints) => checkpoints.save_map(writer, atlas, details),
        None => writer.save(atlas, details),
    };
    mapping.pool().install(save).during("cannot save the map")
}

/// Number of scans in the map that is there.
fn scans_in(writer: &MapWriter) -> usize {
    writer.store().manifest().submaps.iter().map(|submap| submap.scans.len()).sum()
}

/// The path of the map: `output`, or the name of `data` with `.vox` in the current directory.
pub fn path(output: Option<&Path>, data: &Path) -> Result<PathBuf> {
    if let Some(path) = output {
        return Ok(path.to_owned());
    }
    let named = data.file_name().map(|_| data.to_owned()).or_else(|| data.canonicalize().ok());
    match named.as_deref().and_then(Path::file_name) {
        Some(name) => Ok(PathBuf::from(format!("{}.vox", name.to_string_lossy()))),
        None => Err(Error::usage(format!("{}: the map cannot be named after this path", data.display()), "name the map with -o MAP.vox")),
    }
}

/// The current, the home and the temporary folder, without the one that `path` is in.
fn other_folders(path: &Path) -> Vec<PathBuf> {
    let of = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let refused = of.canonicalize().unwrap_or_else(|_| of.to_owned());
    let all = [Some(PathBuf::from(".")), std::env::home_dir(), Some(std::env::temp_dir())];
    let mut known = vec![refused];
    let is_new = |folder: &PathBuf| {
        folder.canonicalize().is_ok_and(|whole| {
            !known.contains(&whole) && {
                known.push(whole);
                true
            }
        })
    };
    all.into_iter().flatten().filter(is_new).collect()
}

/// The path with `suffix` after its stem: `hall-2.vox`.
fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.file_stem().unwrap_or_default().to_owned();
    name.push(suffix);
    if let Some(extension) = path.extension() {
        name.push(".");
        name.push(extension);
    }
    path.with_file_name(name)
}

/// The path of something set aside: `hall-damaged.vox`, or with the first number that is free, `hall-damaged-2.vox`.
fn free_name(path: &Path, word: &str) -> PathBuf {
    let name = |number: u32| with_suffix(path, &if number > 1 { format!("-{word}-{number}") } else { format!("-{word}") });
    (1..).map(name).find(|aside| std::fs::symlink_metadata(aside).is_err()).unwrap_or_else(|| name(u32::MAX))
}

/// A writer at the first path like `path` that is free, from `first` on: 1 is `hall.vox`, 2 `hall-2.vox`.
fn free_path(path: &Path, first: u32) -> Result<(PathBuf, MapWriter)> {
    for number in first.. {
        let path = if number == 1 { path.to_owned() } else { with_suffix(path, &format!("-{number}")) };
        // Fails where anything is, also a map that another process has begun meanwhile.
        match std::fs::create_dir(&path) {
            Err(error) if error.kind() == ErrorKind::AlreadyExists => continue,
            other => other.during(format!("cannot make {}", path.display()))?,
        }
        let writer = MapWriter::create(&path).during(format!("cannot write the map to {}", path.display()));
        if writer.is_err() {
            let _ = std::fs::remove_dir(&path);
        }
        return writer.map(|writer| (path, writer));
    }
    Err(Error::new(format!("{}: no name is free beside it", path.display()), ""))
}
