//! The budget of the process, and the thread that keeps it.

use super::arrays::Arrays;
use super::mapping::{is_in_memory, resident_bytes};
use super::region::Region;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::time::Duration;

/// The files of the budget; a process has them once.
static FILES: OnceLock<Files> = OnceLock::new();
/// The budget, bytes; 0 if there is none.
static BUDGET: AtomicU64 = AtomicU64::new(0);
/// Whether the budget is used up by what is not in the file.
static IS_TIGHT: AtomicBool = AtomicBool::new(false);
/// Whether large arrays come from a file, too.
static HAS_ARRAYS: AtomicBool = AtomicBool::new(false);

/// Memory is given back when less than this share of the budget is left, until that share is left twice.
const LEFT: f64 = 0.06;
/// The same while arrays are in the file, too: loops over them read several gigabytes a second, which the thread sees a few milliseconds later.
const LEFT_WITH_ARRAYS: f64 = 0.25;
/// The thread looks again before the process can have taken what is left, if it takes no more than this, bytes a second. What the system has of
/// the file comes back sixteen pages at a time, which is faster than memory is filled.
const FASTEST_GROWTH: f64 = 20e9;
/// The thread looks at least and at most this often.
const LOOKS: [Duration; 2] = [Duration::from_micros(500), Duration::from_millis(20)];
/// Time between two looks while the budget is exceeded: what cannot be given back is not asked for all the time, because what is in use comes back
/// at once.
const PAUSE_IF_EXCEEDED: Duration = Duration::from_millis(4);

/// Where the memory of fields and that of large arrays come from.
#[derive(Debug)]
struct Files {
    region: Region,
    arrays: Arrays,
}

impl Files {
    fn new(folder: &Path) -> io::Result<Self> {
        Ok(Self { region: Region::new(folder)?, arrays: Arrays::new(folder)? })
    }

    /// Number of chunks of both.
    fn chunks(&self) -> usize {
        self.region.chunks() + self.arrays.chunks()
    }

    /// Gives the memory of a chunk back.
    fn release(&self, chunk: usize) {
        match chunk.checked_sub(self.region.chunks()) {
            None => self.region.release(chunk..chunk + 1),
            Some(chunk) => self.arrays.release(chunk..chunk + 1),
        }
    }

    fn release_all(&self) {
        self.region.release(0..self.region.chunks());
        self.arrays.release(0..self.arrays.chunks());
    }

    fn is_full(&self) -> bool {
        self.region.is_full() || self.arrays.is_full()
    }
}

/// Why there can be no budget.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MemoryError {
    /// No file could be made.
    #[error("{}: cannot make a file for what is beyond the memory budget, or have it in memory: {source}; TMPDIR names another folder", folder.display())]
    File {
        /// The folder.
        folder: PathBuf,
        /// The cause.
        source: io::Error,
    },
    /// The folder is in memory itself.
    #[error("{}: is in memory, not on a disk: TMPDIR names a folder for what is beyond the memory budget", folder.display())]
    InMemory {
        /// The folder.
        folder: PathBuf,
    },
    /// The system does not say how much memory the process has.
    #[error("a memory budget needs Linux")]
    Unsupported,
}

/// Limits the resident memory of the process to `bytes` and about a tenth, as far as it is memory of maps; 0 removes the limit.
///
/// Maps, or parts of them, that are made from now on are kept in a file in `folder` (none: `TMPDIR`, or `/var/tmp`) that can become as large as
/// they are, see the [module](super). The folder of the first call serves all later ones. A process that is forked off must not change maps that
/// its parent has.
///
/// # Errors
/// [`MemoryError`]; there is no new limit then.
pub fn limit(bytes: u64, folder: Option<&Path>) -> Result<(), MemoryError> {
    if bytes > 0 {
        open_files(folder)?;
    }
    BUDGET.store(bytes, Ordering::Relaxed);
    IS_TIGHT.store(false, Ordering::Relaxed);
    Ok(())
}

/// Keeps large arrays in a file, too, while there is a [limit], if the program's global allocator is a [`BudgetAllocator`](super::BudgetAllocator); with
/// `false` new ones come from the system again.
///
/// It is for what comes after mapping: surfaces, clouds and grids are then part of the budget. While scans are integrated it would only cost time, because every scan uses its
/// arrays.
pub fn keep_arrays_in_file(on: bool) {
    HAS_ARRAYS.store(on, Ordering::Relaxed);
}

/// The [limit](limit) of the process, bytes; 0 if there is none.
pub fn budget() -> u64 {
    BUDGET.load(Ordering::Relaxed)
}

/// Whether memory that is not in the file should become less, though that takes time.
pub(crate) fn is_tight() -> bool {
    budget() > 0 && IS_TIGHT.load(Ordering::Relaxed)
}

/// Makes the files and starts the thread, once.
fn open_files(folder: Option<&Path>) -> Result<(), MemoryError> {
    static OPENING: Mutex<()> = Mutex::new(());
    let _one_at_a_time = OPENING.lock().unwrap_or_else(PoisonError::into_inner);
    if FILES.get().is_some() {
        return Ok(());
    }
    resident_bytes().ok_or(MemoryError::Unsupported)?;
    let from_system = || std::env::var_os("TMPDIR").filter(|folder| !folder.is_empty()).map_or_else(|| PathBuf::from("/var/tmp"), PathBuf::from);
    let folder = folder.map_or_else(from_system, Path::to_owned);
    if is_in_memory(&folder) {
        return Err(MemoryError::InMemory { folder });
    }
    let cannot = |source| MemoryError::File { folder: folder.clone(), source };
    let files = Files::new(&folder).map_err(cannot)?;
    let files = FILES.get_or_init(|| files);
    let started = std::thread::Builder::new().name("memory budget".into()).spawn(move || keep(files));
    started.map(drop).map_err(cannot)
}

/// Where new pages come from: none without a budget.
#[inline]
pub(super) fn region() -> Option<&'static Region> {
    if budget() == 0 { None } else { any_region() }
}

/// Where pages may have come from.
#[inline]
pub(super) fn any_region() -> Option<&'static Region> {
    FILES.get().map(|files| &files.region)
}

/// Where new arrays come from: none without a budget, or if they are not to come from a file.
#[inline]
pub(super) fn arrays() -> Option<&'static Arrays> {
    if budget() > 0 && HAS_ARRAYS.load(Ordering::Relaxed) { any_arrays() } else { None }
}

/// Where arrays may have come from.
#[inline]
pub(super) fn any_arrays() -> Option<&'static Arrays> {
    FILES.get().map(|files| &files.arrays)
}

/// Keeps the process within its budget, for ever.
fn keep(files: &Files) {
    let (mut next, mut warned_of_disk, mut warned_of_rest) = (0, false, false);
    loop {
        let budget = budget();
        let left = if budget == 0 { f64::INFINITY } else { give_back(files, budget, &mut next) };
        if left < 0.0 && !warned_of_rest {
            let beyond = -left / 1e6;
            tracing::warn!("the memory budget is exceeded by {beyond:.0} MB: what is in use at one time is more");
            warned_of_rest = true;
        }
        if files.is_full() && !warned_of_disk {
            tracing::warn!("no room can be reserved on the disk for what is beyond the memory budget: new parts of the map stay in memory");
            warned_of_disk = true;
        }
        let until_used = Duration::try_from_secs_f64(left / FASTEST_GROWTH).unwrap_or(LOOKS[1]);
        std::thread::sleep(if left < 0.0 { PAUSE_IF_EXCEEDED } else { until_used.clamp(LOOKS[0], LOOKS[1]) });
    }
}

/// Gives memory of `files` back, beginning with chunk `next`, if it has to be. Returns what is left of the budget, bytes, negative if it is
/// exceeded nevertheless.
fn give_back(files: &Files, budget: u64, next: &mut usize) -> f64 {
    let left = || resident_bytes().map_or(f64::INFINITY, |bytes| budget as f64 - bytes as f64);
    let reserve = if HAS_ARRAYS.load(Ordering::Relaxed) { LEFT_WITH_ARRAYS } else { LEFT } * budget as f64;
    let mut now = left();
    if now > reserve {
        if now > 3.0 * reserve {
            IS_TIGHT.store(false, Ordering::Relaxed);
        }
        return now;
    }
    if is_tight() {
        files.release_all();
        return left();
    }
    for _ in 0..files.chunks() {
        *next = if *next < files.chunks() { *next } else { 0 };
        files.release(*next);
        *next += 1;
        now = left();
        if now > 2.0 * reserve {
            return now;
        }
    }
    IS_TIGHT.store(true, Ordering::Relaxed);
    now
}
