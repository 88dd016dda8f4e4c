//! Child processes: run to the end or to a time limit, and read their output.

use crate::error::{BenchError, Result};
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::{Duration, Instant};

/// A command line as one would type it.
pub(crate) fn command_line(program: &str, arguments: &[String]) -> String {
    let quoted = |word: &String| if word.contains([' ', '"']) { format!("'{word}'") } else { word.clone() };
    std::iter::once(program.to_owned()).chain(arguments.iter().map(quoted)).collect::<Vec<_>>().join(" ")
}

/// Runs a program and parses its output, which must be one JSON object.
pub(crate) fn run_json(program: &Path, arguments: &[String]) -> Result<Value> {
    let command = command_line(&program.display().to_string(), arguments);
    serde_json::from_str(&output(program, arguments)?).map_err(|e| BenchError::Answer { command, problem: e.to_string() })
}

/// Runs a program and returns its output.
pub(crate) fn output(program: &Path, arguments: &[String]) -> Result<String> {
    let command = command_line(&program.display().to_string(), arguments);
    let out = Command::new(program).args(arguments).stdin(Stdio::null()).output();
    let out = out.map_err(|source| BenchError::Start { command: command.clone(), source })?;
    if !out.status.success() {
        return Err(BenchError::Failed { command, status: out.status.to_string(), message: last_lines(&out.stderr) });
    }
    String::from_utf8(out.stdout).map_err(|e| BenchError::Answer { command, problem: e.to_string() })
}

/// The last lines of an output.
fn last_lines(stderr: &[u8]) -> String {
    let text = String::from_utf8_lossy(stderr);
    let lines: Vec<&str> = text.lines().filter(|l| !l.trim().is_empty()).collect();
    lines[lines.len().saturating_sub(4)..].join("; ")
}

/// How a program ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Outcome {
    /// Without error.
    Success,
    /// With this exit status.
    Failed(String),
    /// Stopped at the time limit.
    TimedOut,
}

/// Runs a program, passes each line that it prints to `handle`, and stops it after `limit`.
pub(crate) fn run_lines(program: &str, arguments: &[String], limit: Duration, mut handle: impl FnMut(&str)) -> Result<Outcome> {
    let command = command_line(program, arguments);
    let deadline = Instant::now() + limit;
    let child = Command::new(program).args(arguments).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::inherit()).spawn();
    let mut child = child.map_err(|source| BenchError::Start { command: command.clone(), source })?;
    let stdout = child.stdout.take().ok_or_else(|| BenchError::Answer { command, problem: "no output".to_owned() })?;
    let (sender, receiver) = channel();
    // Ends with the program, or when the receiver is dropped.
    std::thread::spawn(move || BufReader::new(stdout).lines().map_while(std::result::Result::ok).all(|line| sender.send(line).is_ok()));
    loop {
        match receiver.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
            Ok(line) => handle(&line),
            Err(RecvTimeoutError::Timeout) => {
                stop(&mut child);
                return Ok(Outcome::TimedOut);
            }
            Err(RecvTimeoutError::Disconnected) => break,
        }
    }
    Ok(match child.wait() {
        Ok(status) if status.success() => Outcome::Success,
        Ok(status) => Outcome::Failed(status.to_string()),
        Err(error) => Outcome::Failed(error.to_string()),
    })
}

/// Stops a program; it may have ended already.
fn stop(child: &mut Child) {
    let _ = child.kill();
    let _ = child.wait();
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    fn shell(script: &str) -> Vec<String> {
        vec!["-c".to_owned(), script.to_owned()]
    }

    #[test]
    fn output_is_json_and_failures_are_reported() {
        let sh = Path::new("/bin/sh");
        assert_eq!(run_json(sh, &shell("echo '{\"a\": 1}'")).unwrap()["a"], 1);
        let failed = run_json(sh, &shell("echo no luck >&2; exit 3")).unwrap_err().to_string();
        assert!(failed.contains("no luck") && failed.contains('3'), "{failed}");
        assert!(run_json(sh, &shell("echo nonsense")).unwrap_err().to_string().contains("invalid answer"));
        assert!(run_json(Path::new("/no/such/program"), &[]).unwrap_err().to_string().contains("cannot be started"));
    }

    #[test]
    fn program_is_stopped_at_the_limit_and_its_lines_are_kept() {
        let mut lines = Vec::new();
        let end = run_lines("/bin/sh", &shell("echo one; exec sleep 20"), Duration::from_millis(300), |l| lines.push(l.to_owned())).unwrap();
        assert_eq!((end, lines), (Outcome::TimedOut, vec!["one".to_owned()]));
        let end = run_lines("/bin/sh", &shell("exit 4"), Duration::from_secs(10), |_| ()).unwrap();
        assert!(matches!(end, Outcome::Failed(how) if how.contains('4')));
    }
}
