//! How commands fail: what is printed, and with which exit code.

use std::fmt;
use std::process::ExitCode;

/// The work was done.
pub const DONE: u8 = 0;
/// The work could not be done; the message says why.
pub const FAILED: u8 = 1;
/// The command line or the configuration file is wrong. Argument parsing itself ends with the same code.
pub const USAGE: u8 = 2;
/// Interrupted by Ctrl-C or a request to terminate; what was done until then is kept.
pub const INTERRUPTED: u8 = 130;

/// Exit codes as the long help shows them.
pub const EXIT_CODES: &str = "\
Exit codes:
  0    done
  1    failed; the message names the file, the place in it and the remedy
  2    wrong command line or configuration file
  101  a bug in voxelastic
  130  interrupted (Ctrl-C); what was done until then was saved";

/// An error with something to do about it.
#[derive(Debug)]
pub struct Failure {
    message: String,
    remedy: String,
    code: u8,
}

impl Failure {
    /// A failure of the work itself.
    pub fn new(message: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { message: message.into(), remedy: remedy.into(), code: FAILED }
    }

    /// A failure that the command line or the configuration file is to blame for.
    pub fn usage(message: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { code: USAGE, ..Self::new(message, remedy) }
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for Failure {}

/// Prints an error with its causes and its remedy to stderr, and gives the exit code.
pub fn report(error: &anyhow::Error) -> ExitCode {
    eprint!("{}", describe(error));
    let own = error.chain().find_map(|e| e.downcast_ref::<Failure>());
    ExitCode::from(own.map_or(FAILED, |f| f.code))
}

/// `error: ...`, then one line for each cause that says something new, then the remedy.
fn describe(error: &anyhow::Error) -> String {
    let mut text = format!("error: {error}\n");
    let mut last = error.to_string();
    for cause in error.chain().skip(1).map(ToString::to_string) {
        if !last.contains(&cause) {
            text.push_str(&format!("  caused by: {cause}\n"));
        }
        last = cause;
    }
    let remedy = error.chain().find_map(|e| e.downcast_ref::<Failure>()).map(|f| f.remedy.as_str());
    if let Some(remedy) = remedy.filter(|r| !r.is_empty()) {
        text.push_str(&format!("  remedy: {remedy}\n"));
    }
    text
}

/// Makes a panic end with a calm message instead of a backtrace.
pub fn install_panic_hook() {
    std::panic::set_hook(Box::new(|info| {
        let place = info.location().map_or_else(String::new, |l| format!(" ({}:{})", l.file(), l.line()));
        let payload = info.payload();
        let what = payload.downcast_ref::<&str>().copied().or_else(|| payload.downcast_ref::<String>().map(String::as_str));
        eprintln!("error: voxelastic {} has a bug: {}{place}", env!("CARGO_PKG_VERSION"), what.unwrap_or("no details"));
        eprintln!("  Maps that were saved before are untouched.");
        eprintln!("  remedy: please report this line with the command you ran; RUST_BACKTRACE=1 adds details.");
        if std::env::var_os("RUST_BACKTRACE").is_some() {
            eprintln!("{}", std::backtrace::Backtrace::force_capture());
        }
    }));
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::Context;

    #[test]
    fn an_error_shows_its_causes_once_and_its_remedy_last() {
        let inner: anyhow::Result<()> = Err(Failure::new("disk is full", "free some space").into());
        let error = inner.context("cannot save the map").unwrap_err();
        assert_eq!(describe(&error), "error: cannot save the map\n  caused by: disk is full\n  remedy: free some space\n");
        let repeated = anyhow::anyhow!("no such file").context("x.pcd: no such file");
        assert_eq!(describe(&repeated), "error: x.pcd: no such file\n");
    }
}
