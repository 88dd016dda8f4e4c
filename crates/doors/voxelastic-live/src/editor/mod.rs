//! The page on which a map is mended by hand: the viewer's page and server, with what changes a [`Draft`] of the map.
//!
//! | module | contents |
//! | --- | --- |
//! | `routes` | what the page asks for, over HTTP, with a token |
//! | `scene_updates` | what pages are sent: surfaces by submap, poses, the path, closures, edits |
//!
//! The thread that calls [`EditPage::stay`] has the map; requests wait for it in their order. What they change is told to all pages by the viewer's socket.

mod routes;
mod scene_updates;

use crate::http::{HttpServer, unknown_word};
use crate::scene::Scene;
use crate::{page, viewer};
use routes::{Answer, Asked, Request};
use scene_updates::SceneUpdates;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::time::Duration;

use voxelastic_run::editing::{Draft, parse};
use voxelastic_run::{Error, Result};

/// Requests that may wait for the map: a page has one at a time.
const WAITING: usize = 32;
/// How often it is looked whether to stop.
const LOOK: Duration = Duration::from_millis(50);

/// The editor of a map, and its server.
pub struct EditPage {
    draft: Draft,
    updates: SceneUpdates,
    requests: Receiver<Asked>,
    server: HttpServer,
    token: String,
}

impl EditPage {
    /// Opens a map and serves the page at `address`, with port 0 at one that is free. A map that somebody else edits is shown, and not edited. Surfaces have the level
    /// of detail `detail`, 0 to 3. To be called in a pool.
    ///
    /// # Errors
    /// A map that is none or is damaged; an address that is taken or not of this machine.
    pub fn start(map: &Path, address: SocketAddr, detail: u8) -> Result<Self> {
        let draft = Draft::open(map)?;
        let scene = Arc::new(Scene::default());
        let updates = SceneUpdates::new(Arc::clone(&scene), detail.into());
        let (asks, requests) = sync_channel(WAITING);
        let title = map.file_name().unwrap_or(map.as_os_str()).to_string_lossy();
        let token = unknown_word();
        let routes = viewer::routes(scene, page::edit_html(&title), None).merge(routes::routes(asks, &token));
        let server = HttpServer::start("editor", address, Vec::new(), routes).map_err(|error| {
            let remedy = "another program may use that port: name another address, or port 0 for one that is free";
            Error::new(format!("cannot serve the editor at {address}: {error}"), remedy)
        })?;
        Ok(Self { draft, updates, requests, server, token })
    }

    /// Where the page is, with the token. Browsers do not send what is behind the `#`.
    pub fn url(&self) -> String {
        format!("http://{}/#{}", self.server.address(), self.token)
    }

    /// Does what pages ask for until it is stopped; returns how many edits were not saved.
    ///
    /// # Errors
    /// When the map cannot be read.
    pub fn stay(mut self, pool: &rayon::ThreadPool, is_stopped: impl Fn() -> bool) -> Result<usize> {
        tracing::info!("editor: {}", self.url());
        if let Some(why) = self.draft.why_read_only() {
            tracing::warn!("{why}: the page shows it as it is");
        }
        if !self.server.address().ip().is_loopback() {
            tracing::warn!("everyone who reaches {} sees the map; who knows the token edits it", self.server.address());
        }
        pool.install(|| self.updates.send(&self.draft))?;
        while !is_stopped() {
            match self.requests.recv_timeout(LOOK) {
                Ok(Asked { request, answer }) => {
                    let answered = pool.install(|| self.answer(request));
                    // Who asked may have gone.
                    let _ = answer.send(answered);
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
        }
        let (saved, _) = self.draft.saved();
        Ok(self.draft.edits().count().saturating_sub(saved))
    }

    fn answer(&mut self, request: Request) -> Answer {
        let done = self.change(request);
        // Also after an error: what was tried before is gone.
        let sent = self.updates.send(&self.draft);
        let words = |error: Error| match error.remedy() {
            Some(remedy) => format!("{} ({remedy})", error.one_line()),
            None => error.one_line(),
        };
        done.and_then(|words| sent.map(|()| words)).map_err(words)
    }

    fn change(&mut self, request: Request) -> Result<String> {
        let draft = &mut self.draft;
        let is_done = match request {
            Request::Try(text) => {
                let mut edits = parse(&text, "edit")?;
                let (Some(edit), true) = (edits.pop(), edits.is_empty()) else {
                    return Err(Error::usage("one edit is tried at a time", "send one table [[edit]]"));
                };
                draft.attempt(edit)?;
                return Ok(draft.trial().map_or_else(String::new, |trial| trial.words));
            }
            Request::Save => {
                draft.save()?;
                return Ok("saved".to_owned());
            }
            Request::Suggest => {
                let found = draft.suggestions()?;
                let words = if found.is_empty() { "nothing is inconsistent".to_owned() } else { format!("{} suggestions", found.len()) };
                self.updates.keep_suggestions(found, draft);
                return Ok(words);
            }
            Request::Saved | Request::Draft => {
                draft.show_saved(request == Request::Saved);
                return Ok(if draft.shows_saved() { "the map as it is saved" } else { "the map with the edits" }.to_owned());
            }
            Request::Accept => draft.accept(),
            Request::Discard => draft.discard(),
            Request::Undo => draft.undo(),
            Request::Redo => draft.redo(),
        };
        Ok(if is_done { "done" } else { "there is nothing to do" }.to_owned())
    }
}
