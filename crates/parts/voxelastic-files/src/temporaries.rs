//! Names of temporaries, and what killed programs leave of them.

use std::collections::HashSet;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

/// What the names of temporaries end with: nobody else's files do.
const ENDING: &str = ".voxelastic.tmp";
/// Characters of a file's name that are in that of its temporary: at most four bytes each, of some 250 that file systems allow.
const LONGEST_NAME: usize = 40;
/// The file in a folder that is locked as long as the folder is used.
pub(crate) const LOCK: &str = "lock";

/// The folder of a file.
pub(crate) fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// A name of a temporary beside `path` that this process has not used before. Of a long name it has the beginning: names have limits.
pub(crate) fn temporary_name(path: &Path) -> PathBuf {
    static COUNTER: AtomicU64 = AtomicU64::new(0);
    let name: String = path.file_name().unwrap_or_default().to_string_lossy().chars().take(LONGEST_NAME).collect();
    path.with_file_name(format!(".{name}.{}-{}{ENDING}", std::process::id(), COUNTER.fetch_add(1, Ordering::Relaxed)))
}

/// Removes what killed programs left in `folder`, once in each folder that this program writes to.
pub(crate) fn remove_litter_once(folder: &Path) {
    static SEEN: Mutex<Option<HashSet<PathBuf>>> = Mutex::new(None);
    let whole = fs::canonicalize(folder).unwrap_or_else(|_| folder.to_owned());
    let is_new = SEEN.lock().is_ok_and(|mut seen| seen.get_or_insert_default().insert(whole));
    if is_new {
        remove_litter(folder);
    }
}

/// Removes temporaries that no program has open.
pub(crate) fn remove_litter(folder: &Path) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    for entry in entries.flatten() {
        let name = entry.file_name();
        let ours = name.to_str().is_some_and(|name| name.starts_with('.') && name.ends_with(ENDING));
        let Some(kind) = entry.file_type().ok().filter(|_| ours) else { continue };
        let path = entry.path();
        if kind.is_dir() {
            remove_if_dead(&path);
        } else if kind.is_file()
            && let Ok(file) = File::open(&path)
            && file.try_lock().is_ok()
        {
            // One that may not be removed only takes space. The lock is held until it is gone.
            let _ = fs::remove_file(&path);
        }
    }
}

/// Removes a folder that no program uses any more.
fn remove_if_dead(folder: &Path) {
    match File::open(folder.join(LOCK)) {
        Ok(lock) if lock.try_lock().is_ok() => drop(fs::remove_dir_all(folder)),
        Ok(_) => {}
        // One in which nothing was written yet.
        Err(_) => drop(fs::remove_dir(folder)),
    }
}
