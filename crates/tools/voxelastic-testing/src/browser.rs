//! A headless browser for tests of pages.

use crate::skip::{Need, skip};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Duration;

/// Chromium or Chrome without a window, with one page. Stopped when dropped.
#[derive(Debug)]
pub struct Browser(Child);

impl Browser {
    /// How long tests wait for a page: a browser on a busy machine without a graphics card is slow.
    pub const TIMEOUT: Duration = crate::PATIENCE;

    /// Opens `url` with the further flags; `profile` is a folder of its own for the browser's files. None, after noting the skip, without a browser.
    ///
    /// # Panics
    /// Without a browser, if one is required.
    pub fn open(url: &str, profile: &Path, flags: &[&str]) -> Option<Self> {
        const FLAGS: [&str; 10] = [
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--enable-unsafe-swiftshader",
            "--disable-quic",
            "--no-first-run",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
            "--disable-dev-shm-usage",
        ];
        let child = ["chromium", "chromium-browser", "google-chrome"].into_iter().find_map(|name| {
            let mut command = Command::new(name);
            command.args(FLAGS).args(flags).arg(format!("--user-data-dir={}", profile.display())).arg(url);
            command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().ok()
        });
        if child.is_none() {
            skip(Need::Browser, "neither chromium nor google-chrome is installed");
        }
        child.map(Self)
    }

    /// How the browser ended, if it has.
    pub fn ended(&mut self) -> Option<ExitStatus> {
        self.0.try_wait().ok().flatten()
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
