//! What fails for a moment only.

use std::io;
use std::time::Duration;

/// Waits between tries: each is twice the one before, some four seconds in all.
const FIRST_WAIT: Duration = Duration::from_millis(2);
const TRIES: u32 = 12;

/// Tries again what the system refuses for a moment: too many open files (of this process, or of all), a disk or a network that stutters. What is wrong for longer
/// is returned as it is. `attempt` begins anew each time.
///
/// # Errors
/// Those of the last try.
pub fn patiently<T>(mut attempt: impl FnMut() -> io::Result<T>) -> io::Result<T> {
    let mut wait = FIRST_WAIT;
    for _ in 1..TRIES {
        match attempt() {
            Err(error) if passes(&error) => std::thread::sleep(wait),
            other => return other,
        }
        wait *= 2;
    }
    attempt()
}

/// Whether an error may be gone in a moment. Its kind does not tell: the standard library has none for most of these.
fn passes(error: &io::Error) -> bool {
    // The numbers are the same on all systems of the Unix family that Rust runs on, but EAGAIN.
    const CODES: [i32; 3] = [5, 23, 24]; // EIO, ENFILE, EMFILE
    let is_refusal = cfg!(unix) && error.raw_os_error().is_some_and(|code| CODES.contains(&code));
    is_refusal || matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The results of something that fails with each of these codes, in their order, and how often it was tried.
    fn tried(codes: &[i32]) -> (io::Result<usize>, usize) {
        let mut tries = 0;
        let result = patiently(|| {
            tries += 1;
            codes.get(tries - 1).map_or(Ok(tries), |code| Err(io::Error::from_raw_os_error(*code)))
        });
        (result, tries)
    }

    #[cfg(unix)]
    #[test]
    fn what_passes_is_waited_for_and_nothing_else() {
        assert_eq!(tried(&[24, 23, 5, 11]).0.unwrap(), 5);
        let (result, tries) = tried(&[2]);
        assert!(result.unwrap_err().kind() == io::ErrorKind::NotFound && tries == 1);
        assert_eq!(tried(&[24; 100]).1, TRIES as usize);
    }
}
