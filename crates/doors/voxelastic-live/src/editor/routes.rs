//! What the page of the editor asks for.
//!
//! | path | what |
//! | --- | --- |
//! | `POST /edit/try` | tries the edit in the body, one table `[[edit]]` as in a list of edits |
//! | `POST /edit/accept`, `/edit/discard` | takes or drops it |
//! | `POST /edit/undo`, `/edit/redo`, `/edit/save` | what they say |
//! | `POST /edit/suggest` | looks for what is least consistent |
//! | `POST /edit/saved`, `/edit/draft` | shows the map as it is on the disk, or with the edits again |
//!
//! Each with `Authorization: Bearer TOKEN`.

use crate::http::Token;
use axum::Router;
use axum::body::{Body, to_bytes};
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, Uri};
use axum::response::{IntoResponse, Response};
use axum::routing::post;
use std::sync::Arc;
use std::sync::mpsc::SyncSender;
use std::time::Duration;
use tokio::sync::oneshot;

/// A request ends within this time, and is no longer than this.
const REQUEST_TIME: Duration = Duration::from_secs(5);
const LARGEST_REQUEST: usize = 256 << 10;

/// What is asked for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Request {
    /// Tries an edit, as text.
    Try(String),
    /// Takes it.
    Accept,
    /// Drops it.
    Discard,
    /// Takes the last one back.
    Undo,
    /// Does it again.
    Redo,
    /// Writes all.
    Save,
    /// Looks for what is least consistent.
    Suggest,
    /// Shows the map on the disk.
    Saved,
    /// Shows the map with the edits.
    Draft,
}

/// What was done, or why it was not.
pub type Answer = Result<String, String>;

/// A request, and where its answer goes.
pub struct Asked {
    /// What is asked for.
    pub request: Request,
    /// Who waits.
    pub answer: oneshot::Sender<Answer>,
}

#[derive(Clone)]
struct Site {
    asks: SyncSender<Asked>,
    token: Option<Arc<Token>>,
}

/// The routes; requests with the token go to `asks`.
pub fn routes(asks: SyncSender<Asked>, token: &str) -> Router {
    let site = Site { asks, token: Token::new(token).map(Arc::new) };
    let names = ["try", "accept", "discard", "undo", "redo", "save", "saved", "draft", "suggest"];
    names.into_iter().fold(Router::new(), |routes, name| routes.route(&format!("/edit/{name}"), post(edit))).with_state(site)
}

async fn edit(State(site): State<Site>, headers: HeaderMap, uri: Uri, body: Body) -> Response {
    if !site.token.is_some_and(|token| token.is_in(&headers)) {
        return (StatusCode::UNAUTHORIZED, "open the page at the whole address that the program printed: its token is behind the #\n")
            .into_response();
    }
    let Ok(body) = tokio::time::timeout(REQUEST_TIME, to_bytes(body, LARGEST_REQUEST)).await else {
        return (StatusCode::REQUEST_TIMEOUT, "the request does not end\n").into_response();
    };
    let Ok(body) = body else { return (StatusCode::PAYLOAD_TOO_LARGE, "the request is too long\n").into_response() };
    let request = match uri.path() {
        "/edit/try" => Request::Try(String::from_utf8_lossy(&body).into_owned()),
        "/edit/accept" => Request::Accept,
        "/edit/discard" => Request::Discard,
        "/edit/undo" => Request::Undo,
        "/edit/redo" => Request::Redo,
        "/edit/save" => Request::Save,
        "/edit/saved" => Request::Saved,
        "/edit/draft" => Request::Draft,
        _ => Request::Suggest,
    };
    let (answer, answered) = oneshot::channel();
    if site.asks.try_send(Asked { request, answer }).is_err() {
        return (StatusCode::SERVICE_UNAVAILABLE, "too many edits wait\n").into_response();
    }
    match answered.await {
        Ok(Ok(words)) => (StatusCode::OK, words).into_response(),
        Ok(Err(words)) => (StatusCode::CONFLICT, words).into_response(),
        Err(_) => (StatusCode::SERVICE_UNAVAILABLE, "the editor has ended\n").into_response(),
    }
}
