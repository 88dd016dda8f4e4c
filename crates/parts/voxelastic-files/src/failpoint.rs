//! Failpoints: an operation on files fails in a test as it does when a disk is full, broken or gone.
//!
//! They are in every build, because a feature would make two of each crate that writes files. While none is armed, one costs the load of a flag.

use std::fs::File;
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

static IS_ARMED: AtomicBool = AtomicBool::new(false);
static PLAN: Mutex<Option<Plan>> = Mutex::new(None);

/// Which operations fail, and which did first.
struct Plan {
    /// Operations until then.
    left: usize,
    /// Whether all that follow fail, too.
    lasts: bool,
    failed: Option<Failed>,
}

/// An operation that failed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failed {
    /// What was to be done.
    pub operation: &'static str,
    /// With which file or folder.
    pub path: PathBuf,
}

/// Lets the operation after so many others fail, in all threads of this process; with `lasts`, all that follow, too, those that clean up among them: what
/// is left then is what a process leaves that is killed there.
pub fn arm(after: usize, lasts: bool) {
    *plan() = Some(Plan { left: after, lasts, failed: None });
    IS_ARMED.store(true, Ordering::SeqCst);
}

/// Ends that. Returns what has failed first; none if there were not so many operations.
pub fn disarm() -> Option<Failed> {
    IS_ARMED.store(false, Ordering::SeqCst);
    plan().take()?.failed
}

/// To be called before an operation.
///
/// # Errors
/// Where the operation is to fail.
pub fn check(operation: &'static str, path: &Path) -> io::Result<()> {
    if !IS_ARMED.load(Ordering::Relaxed) {
        return Ok(());
    }
    let mut plan = plan();
    let Some(plan) = plan.as_mut() else { return Ok(()) };
    let fails = if plan.failed.is_some() { plan.lasts } else { plan.left == 0 };
    if !fails {
        plan.left = plan.left.saturating_sub(1);
        return Ok(());
    }
    plan.failed.get_or_insert_with(|| Failed { operation, path: path.to_owned() });
    Err(io::Error::other("a failpoint of a test"))
}

/// A file each of whose writes may fail, as on a disk that runs full: half of the bytes are written before.
#[derive(Debug)]
pub struct Writes<'a> {
    file: File,
    path: &'a Path,
}

impl<'a> Writes<'a> {
    /// Writes to `file`, which is to become, or is, the one at `path`.
    pub fn new(file: File, path: &'a Path) -> Self {
        Self { file, path }
    }

    /// Makes what is written durable.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn sync_all(&self) -> io::Result<()> {
        check("make durable", self.path)?;
        self.file.sync_all()
    }

    /// The file.
    pub fn file(&self) -> &File {
        &self.file
    }
}

impl Write for Writes<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if let Err(error) = check("write", self.path) {
            self.file.write_all(&bytes[..bytes.len() / 2])?;
            return Err(error);
        }
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Seek for Writes<'_> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}

fn plan() -> MutexGuard<'static, Option<Plan>> {
    PLAN.lock().unwrap_or_else(PoisonError::into_inner)
}
