//! The viewer of a node or of a saved map: what it is told, and where it is.

use crate::link::Link;
use crate::publisher::Publisher;
use crate::scene::Scene;
use crate::viewer::{Control, Viewer};
use serde_json::json;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};
use voxelastic::atlas::Atlas;
use voxelastic_run::{Error, Result};

/// Figures are sent at most this often.
const FIGURES: Duration = Duration::from_millis(250);
/// A pause when nothing is to do, and one while tiles of the surface are made.
const PAUSES: [Duration; 2] = [Duration::from_millis(50), Duration::from_millis(2)];

/// A viewer of a node.
#[derive(Clone, Debug)]
pub struct ViewerSetup {
    /// Where it is served; port 0 is one that is free.
    pub address: SocketAddr,
    /// Origins whose pages may read it, beside its own.
    pub origins: Vec<String>,
    /// Level of detail of the surface: 0 is full resolution.
    pub detail: u8,
    /// What it is served over, where that limits what goes out.
    pub link: Option<Arc<Link>>,
    /// A file with the token of those who may control the node over HTTP.
    pub token: Option<PathBuf>,
}

/// Figures of a node.
#[derive(Clone, Debug, Default)]
pub struct Figures {
    /// What it does: `starting`, `mapping`, `finished`, `a saved map`.
    pub state: &'static str,
    /// Scans in the map.
    pub scans: usize,
    /// Scans that were left out.
    pub left_out: usize,
    /// Submaps.
    pub submaps: usize,
    /// Memory of the map, megabytes.
    pub map_mb: f64,
    /// Memory of the process, megabytes; none where the system does not tell.
    pub rss_mb: Option<f64>,
    /// From the coming of the last scan to its being in the map.
    pub delay_ms: Option<f64>,
}

impl Figures {
    fn json(&self) -> String {
        let mut rows = vec![["State".to_owned(), self.state.to_owned()], ["Scans".to_owned(), self.scans.to_string()]];
        if self.left_out > 0 {
            rows.push(["Left out".to_owned(), self.left_out.to_string()]);
        }
        rows.push(["Submaps".to_owned(), self.submaps.to_string()]);
        rows.push(["Map".to_owned(), format!("{:.1} MB", self.map_mb)]);
        rows.extend(self.rss_mb.map(|mb| ["Memory".to_owned(), format!("{mb:.0} MB")]));
        rows.extend(self.delay_ms.map(|ms| ["Scan to map".to_owned(), format!("{ms:.0} ms")]));
        json!({
            "state": self.state, "scans": self.scans, "scans_left_out": self.left_out, "submaps": self.submaps,
            "map_mb": self.map_mb, "rss_mb": self.rss_mb, "delay_ms": self.delay_ms, "rows": rows,
        })
        .to_string()
    }
}

/// A viewer's server, and what tells it about the map.
pub struct Watch {
    /// Poses, trajectory, loops, scans and surfaces.
    pub publisher: Publisher,
    viewer: Viewer,
    last_figures: Option<Instant>,
}

impl Watch {
    /// Starts the server, and says where it is and what it shows. `name` is what is mapped.
    pub fn start(name: &Path, setup: &ViewerSetup, control: Option<Control>) -> Result<Self> {
        let address = setup.address;
        let scene = Arc::new(Scene::over(setup.link.clone()));
        let title = name.file_name().unwrap_or(name.as_os_str()).to_string_lossy();
        let controlled = if control.is_some() { "who knows the token can save, pause and reset" } else { "nobody can change anything" };
        let viewer = Viewer::start(Arc::clone(&scene), &title, address, setup.origins.clone(), control).map_err(|error| {
            let remedy = "another program may use that port: name another address, or port 0 for one that is free";
            Error::new(format!("cannot serve the viewer at {address}: {error}"), remedy)
        })?;
        tracing::info!("viewer: http://{}", viewer.address());
        if !viewer.address().ip().is_loopback() {
            tracing::warn!("everyone who reaches {} sees the map, the trajectory and the scans; {controlled}", viewer.address());
        }
        let publisher = Publisher::new(scene, setup.detail.into());
        publisher.statistics(&Figures { state: "starting", ..Figures::default() }.json());
        Ok(Self { publisher, viewer, last_figures: None })
    }

    /// Sends the tiles of the surface that were made, and has others made on other threads, at most as many as `pool` has; false if none were.
    pub fn step(&mut self, atlas: &Atlas, pool: &rayon::ThreadPool) -> bool {
        let publisher = &mut self.publisher;
        pool.install(|| publisher.step(atlas))
    }

    /// Sends figures, if the last ones are old enough.
    pub fn figures(&mut self, figures: impl FnOnce() -> Figures) {
        if self.last_figures.is_none_or(|last| last.elapsed() >= FIGURES) {
            self.last_figures = Some(Instant::now());
            self.publisher.statistics(&figures().json());
        }
    }

    /// Shows a map that does not change any more, until it is stopped.
    pub fn stay(mut self, atlas: &Atlas, pool: &rayon::ThreadPool, figures: Figures, is_stopped: fn() -> bool) {
        self.publisher.statistics(&figures.json());
        let (mut is_settled, mut said) = (false, false);
        while !is_stopped() {
            if self.step(atlas, pool) {
                continue;
            }
            if !self.publisher.is_behind() && !std::mem::replace(&mut is_settled, true) {
                // All of it is there; what a mesh of the whole map has in addition needs a look at all of it.
                let publisher = &mut self.publisher;
                pool.install(|| publisher.settle(atlas));
            } else if !self.publisher.is_behind() && !std::mem::replace(&mut said, true) {
                let (messages, bytes) = self.publisher.scene().size();
                tracing::info!(
                    "the viewer at http://{} has all of it ({messages} parts, {:.1} MB); Ctrl-C ends",
                    self.viewer.address(),
                    bytes as f64 / 1e6
                );
            }
            std::thread::sleep(PAUSES[usize::from(self.publisher.is_busy())]);
        }
    }
}
