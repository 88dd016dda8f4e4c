//! Progress on stderr: a bar on a terminal, else a line every few seconds.

use crate::output;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::{self, IsTerminal, Write};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};
use voxelastic_report::shown::shown;
use voxelastic_run::usage;

/// Time between two lines without a terminal.
const LINE_PERIOD: Duration = Duration::from_secs(5);

/// The bar on the screen; log lines suspend it.
static BAR: Mutex<Option<ProgressBar>> = Mutex::new(None);

/// Progress over items, whose number may be unknown.
pub struct Progress {
    bar: Option<ProgressBar>,
    lines: bool,
    what: &'static str,
    total: Option<u64>,
    done: u64,
    /// Items that were done before it began.
    before: u64,
    started: Instant,
    last_line: Instant,
}

impl Progress {
    /// Progress over `total` items named `what`; `quiet` prints nothing.
    pub fn new(what: &'static str, total: impl Into<Option<u64>>, quiet: bool) -> Self {
        let total = total.into();
        let terminal = io::stderr().is_terminal();
        let bar = (terminal && !quiet).then(|| bar(what, total));
        *BAR.lock().unwrap_or_else(PoisonError::into_inner) = bar.clone();
        let now = Instant::now();
        Self { bar, lines: !terminal && !quiet, what, total, done: 0, before: 0, started: now, last_line: now }
    }

    /// Begins after so many items.
    pub fn start_after(&mut self, items: u64) {
        (self.done, self.before) = (items, items);
        if let Some(bar) = &self.bar {
            bar.set_position(items);
            bar.reset_eta();
        }
    }

    /// Counts an item; `note` is shown after the rate.
    pub fn step(&mut self, note: impl FnOnce() -> String) {
        self.done += 1;
        if let Some(bar) = &self.bar {
            bar.set_message(format!("{}, {}", memory(), note()));
            bar.inc(1);
        } else if self.lines && self.last_line.elapsed() >= LINE_PERIOD {
            self.last_line = Instant::now();
            let rate = (self.done - self.before) as f64 / self.started.elapsed().as_secs_f64().max(1e-9);
            let Self { what, done, .. } = *self;
            match self.total {
                Some(total) => {
                    let left = Duration::from_secs_f64(total.saturating_sub(done) as f64 / rate.max(1e-9));
                    output::message(&format!("{done}/{total} {what}, {rate:.1}/s, {} left, {}, {}\n", clock(left), memory(), note()));
                }
                None => output::message(&format!("{done} {what}, {rate:.1}/s, {}, {}\n", memory(), note())),
            }
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
        *BAR.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }
}

fn bar(what: &str, total: Option<u64>) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(total, ProgressDrawTarget::stderr_with_hz(10));
    let template = match total {
        Some(_) => format!("{{bar:30}} {{pos}}/{{len}} {what}, {{per_sec}}, {{eta}} left, {{msg}}"),
        None => format!("{{spinner}} {{pos}} {what}, {{per_sec}}, {{msg}}"),
    };
    if let Ok(style) = ProgressStyle::with_template(&template) {
        bar.set_style(style.with_key("per_sec", |s: &indicatif::ProgressState, w: &mut dyn std::fmt::Write| {
            let _ = write!(w, "{:.1}/s", s.per_sec());
        }));
    }
    bar
}

fn memory() -> String {
    usage::resident_bytes().map_or_else(|| "memory unknown".to_owned(), |b| format!("{:.0} MB", usage::megabytes(b)))
}

/// 75 s as `1:15`.
fn clock(time: Duration) -> String {
    let seconds = time.as_secs();
    if seconds < 3600 {
        format!("{}:{:02}", seconds / 60, seconds % 60)
    } else {
        format!("{}:{:02}:{:02}", seconds / 3600, seconds / 60 % 60, seconds % 60)
    }
}

/// The colours of levels, as terminals have them.
const LEVELS: [(&str, u8); 5] = [("ERROR", 31), ("WARN", 33), ("INFO", 32), ("DEBUG", 34), ("TRACE", 35)];

/// Writer for log lines: stderr, with the bar suspended meanwhile. Names and texts of others in them do nothing to a terminal; the level has a colour if it may have
/// one. It never fails: a log that cannot be written must not end a run.
#[derive(Clone, Copy, Debug)]
pub struct LogWriter {
    /// Whether the terminal shows colours.
    pub has_colours: bool,
}

impl LogWriter {
    fn line(self, bytes: &[u8]) -> String {
        let text = String::from_utf8_lossy(bytes);
        let line = shown(text.strip_suffix('\n').unwrap_or(&text));
        let level = LEVELS.iter().filter(|_| self.has_colours).find(|(level, _)| line.trim_start().starts_with(level));
        match level {
            Some((level, colour)) => line.replacen(level, &format!("\u{1b}[{colour}m{level}\u{1b}[0m"), 1) + "\n",
            None => line.into_owned() + "\n",
        }
    }
}

impl Write for LogWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let bar = BAR.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let line = self.line(bytes);
        let write = || io::stderr().write_all(line.as_bytes());
        let _ = bar.map_or_else(write, |bar| bar.suspend(write));
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        let _ = io::stderr().flush();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn log_lines_are_text() {
        let lines = [false, true].map(|has_colours| LogWriter { has_colours }.line(b" WARN a\x1b[2J\n WARN b\n"));
        assert_eq!(lines, [" WARN a\\u{1b}[2J\\n WARN b\n", " \u{1b}[33mWARN\u{1b}[0m a\\u{1b}[2J\\n WARN b\n"]);
    }

    #[test]
    fn times_are_printed_as_minutes_and_seconds() {
        assert_eq!(clock(Duration::from_secs(75)), "1:15");
        assert_eq!(clock(Duration::from_secs(3 * 3600 + 62)), "3:01:02");
    }
}
