//! Failures of commands: messages and exit codes.

use crate::output;
use std::borrow::Cow;
use std::io::{self, Write};
use voxelastic_report::shown::shown;

/// Success.
pub const DONE: u8 = 0;
/// The command failed; the message gives the reason.
pub const FAILED: u8 = 1;
/// The command line or the configuration file is wrong. Argument parsing itself ends with the same code.
pub const USAGE: u8 = 2;
/// The map is saved, but not in the folder that was asked for: that could not be written, or a session does not fit into the map there.
pub const ELSEWHERE: u8 = 3;
/// `check`: something about the data is doubtful.
pub const DOUBTFUL: u8 = 3;
/// A bug: a panic, here or in a decoder.
pub const BUG: u8 = 101;
/// Interrupted by Ctrl-C or a request to terminate; results up to then are kept.
pub const INTERRUPTED: u8 = 130;

/// Interrupted again, more than a second later: ended at once, without saving.
pub const STOPPED: u8 = 131;

/// Exit codes as the long help shows them.
pub const EXIT_CODES: &str = "\
Exit codes:
  0    done
  1    failed; the message names the file, the place in it and the remedy
  2    wrong command line or configuration file
  3    the map is saved, but elsewhere: its folder could not be written (full disk), or a session's place in the map was
       not found (--into); a warning and --json name it. Of check: something is doubtful
  101  a bug in voxelastic; `map` saves what it has
  130  interrupted (Ctrl-C); results up to then were saved
  131  interrupted again; stopped at once, without saving";

/// An error with a remedy.
pub use voxelastic_run::Error as Failure;

/// Prints an error with its causes and its remedy to stderr, and returns the exit code.
pub fn report(error: &anyhow::Error) -> u8 {
    output::message(&describe(error));
    let is_usage = error.chain().filter_map(|e| e.downcast_ref()).any(Failure::is_usage);
    if is_usage { USAGE } else { FAILED }
}

/// Prints what ended the parsing of the command line, a mistake or a request for help, and returns the exit code.
pub fn report_usage(end: &clap::Error) -> u8 {
    let plain = end.render().to_string();
    if plain.lines().any(|line| matches!(shown(line), Cow::Owned(_))) {
        output::message(&plain);
    } else {
        // As in clap's own `exit`, a stream that cannot be written is no other error.
        let _ = end.print();
    }
    let _ = io::stdout().flush();
    if end.use_stderr() { USAGE } else { DONE }
}

/// An error with its causes on one line, for log messages.
pub fn one_line(error: &anyhow::Error) -> String {
    voxelastic_run::error::one_line(error.as_ref())
}

/// `error: ...`, a line for each cause, and the remedy.
fn describe(error: &anyhow::Error) -> String {
    let messages = voxelastic_run::error::messages(error.as_ref());
    let mut text = format!("error: {}\n", shown(&messages[0]));
    for cause in &messages[1..] {
        text.push_str(&format!("  caused by: {}\n", shown(cause)));
    }
    if let Some(remedy) = error.chain().filter_map(|e| e.downcast_ref()).find_map(Failure::remedy) {
        text.push_str(&format!("  remedy: {}\n", shown(remedy)));
    }
    text
}

/// Replaces the backtrace of a panic by a short message that asks for a bug report.
pub fn install_panic_hook() {
    std::panic::set_hook(Box::new(|info| {
        let place = info.location().map_or_else(String::new, |l| format!(" ({}:{})", l.file(), l.line()));
        let payload = info.payload();
        let what = payload.downcast_ref::<&str>().copied().or_else(|| payload.downcast_ref::<String>().map(String::as_str));
        output::message(&format!(
            "error: voxelastic {} has a bug: {}{place}\n  Maps saved before are not affected.\n  remedy: please report this line with the command; \
             RUST_BACKTRACE=1 adds details.\n",
            env!("CARGO_PKG_VERSION"),
            what.unwrap_or("no details")
        ));
        if std::env::var_os("RUST_BACKTRACE").is_some() {
            output::message(&format!("{}\n", std::backtrace::Backtrace::force_capture()));
        }
    }));
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::Context;

    #[test]
    fn an_error_is_printed_with_each_cause_once_and_the_remedy_last() {
        let inner: anyhow::Result<()> = Err(Failure::new("disk is full", "free some space").into());
        let error = inner.context("cannot save the map").unwrap_err();
        assert_eq!(describe(&error), "error: cannot save the map\n  caused by: disk is full\n  remedy: free some space\n");
        let hostile = anyhow::anyhow!("a\u{1b}[2J\nerror: b: not there");
        assert_eq!(describe(&hostile), "error: a\\u{1b}[2J\\nerror: b: not there\n");
        let repeated = anyhow::anyhow!("no such file").context("x.pcd: no such file");
        assert_eq!(describe(&repeated), "error: x.pcd: no such file\n");
        assert_eq!(one_line(&repeated.context("cannot read the scan")), "cannot read the scan: x.pcd: no such file");
    }
}
