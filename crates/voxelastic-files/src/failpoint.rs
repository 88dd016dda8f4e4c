//! Failpoints: an operation on files fails in a test as it does when a disk is full, broken or gone.
//!
//! They are in every build, because a feature would make two of each crate that writes files. While none is armed, one costs the load of a flag.

use std::io;
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

/// Lets the operation after so many others fail, in all threads of this process; with `lasts`, all that follow, too.
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

fn plan() -> MutexGuard<'static, Option<Plan>> {
    PLAN.lock().unwrap_or_else(PoisonError::into_inner)
}
