//! Programs that are started, waited for, and answered by.

use crate::error::{BenchError, Result};
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::{Duration, Instant};

/// A command line as one would type it.
pub(crate) fn line(program: &str, arguments: &[String]) -> String {
    let quoted = |word: &String| if word.contains([' ', '"']) { format!("'{word}'") } else { word.clone() };
    std::iter::once(program.to_owned()).chain(arguments.iter().map(quoted)).collect::<Vec<_>>().join(" ")
}

/// Runs a program to its end; what it printed must be one JSON object.
pub(crate) fn json(program: &Path, arguments: &[String]) -> Result<Value> {
    let command = line(&program.display().to_string(), arguments);
    let out = Command::new(program).args(arguments).stdin(Stdio::null()).output();
    let out = out.map_err(|source| BenchError::Start { command: command.clone(), source })?;
    if !out.status.success() {
        return Err(BenchError::Failed { command, status: out.status.to_string(), said: tail(&out.stderr) });
    }
    serde_json::from_slice(&out.stdout).map_err(|e| BenchError::Answer { command, what: e.to_string() })
}

/// The last lines of what a program said.
fn tail(stderr: &[u8]) -> String {
    let text = String::from_utf8_lossy(stderr);
    let lines: Vec<&str> = text.lines().filter(|l| !l.trim().is_empty()).collect();
    lines[lines.len().saturating_sub(4)..].join("; ")
}

/// How a program that prints lines ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum End {
    /// By itself, without error.
    Done,
    /// By itself, with this status.
    Failed(String),
    /// It was stopped.
    Stopped,
}

/// Runs a program, hands each line that it prints to `take`, and stops it after `limit`.
pub(crate) fn lines(program: &str, arguments: &[String], limit: Duration, mut take: impl FnMut(&str)) -> Result<End> {
    let command = line(program, arguments);
    let deadline = Instant::now() + limit;
    let child = Command::new(program).args(arguments).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::inherit()).spawn();
    let mut child = child.map_err(|source| BenchError::Start { command: command.clone(), source })?;
    let stdout = child.stdout.take().ok_or_else(|| BenchError::Answer { command, what: "no output".to_owned() })?;
    let (sender, receiver) = channel();
    // Ends by itself when the program does, or when nobody listens any more.
    std::thread::spawn(move || BufReader::new(stdout).lines().map_while(std::result::Result::ok).all(|line| sender.send(line).is_ok()));
    loop {
        match receiver.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
            Ok(line) => take(&line),
            Err(RecvTimeoutError::Timeout) => {
                stop(&mut child);
                return Ok(End::Stopped);
            }
            Err(RecvTimeoutError::Disconnected) => break,
        }
    }
    Ok(match child.wait() {
        Ok(status) if status.success() => End::Done,
        Ok(status) => End::Failed(status.to_string()),
        Err(error) => End::Failed(error.to_string()),
    })
}

/// Ends a program; one that is gone already is fine.
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
    fn answers_are_json_and_failures_are_told() {
        let sh = Path::new("/bin/sh");
        assert_eq!(json(sh, &shell("echo '{\"a\": 1}'")).unwrap()["a"], 1);
        let failed = json(sh, &shell("echo no luck >&2; exit 3")).unwrap_err().to_string();
        assert!(failed.contains("no luck") && failed.contains('3'), "{failed}");
        assert!(json(sh, &shell("echo nonsense")).unwrap_err().to_string().contains("cannot be used"));
        assert!(json(Path::new("/no/such/program"), &[]).unwrap_err().to_string().contains("cannot be started"));
    }

    #[test]
    fn a_program_that_takes_too_long_is_stopped_and_its_lines_are_kept() {
        let mut seen = Vec::new();
        let clock = Instant::now();
        let end = lines("/bin/sh", &shell("echo one; exec sleep 20"), Duration::from_millis(300), |l| seen.push(l.to_owned())).unwrap();
        assert_eq!((end, seen), (End::Stopped, vec!["one".to_owned()]));
        assert!(clock.elapsed() < Duration::from_secs(10));
        let end = lines("/bin/sh", &shell("exit 4"), Duration::from_secs(10), |_| ()).unwrap();
        assert!(matches!(end, End::Failed(how) if how.contains('4')));
    }
}
