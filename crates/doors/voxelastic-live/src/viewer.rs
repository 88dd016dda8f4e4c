//! The server of the viewer: a page, a socket with what it shows, and the node's health, over HTTP.
//!
//! | path | what |
//! | --- | --- |
//! | `/` | the page |
//! | `/socket` | a WebSocket with the messages of [`wire`]; nothing that is sent to it has an effect |
//! | `/health` | the figures of the node, as JSON |
//! | `POST /save`, `/mesh`, `/pause`, `/resume`, `/reset`, `/load` with the path of a map, `/explore`, `/explore/pause`, `/explore/home` | what [`Request`] says, for those who send the token: `Authorization: Bearer TOKEN` |
//!
//! It serves what is in a [`Scene`], to those whom `HttpServer` lets in. Without a token it changes nothing.

use crate::http::{HttpServer, Place, Token, unknown_word};
use crate::link::{Link, Urgency};
use crate::page;
use crate::ros::services::{Request, RequestSender, Response as Answered};
use crate::scene::{Have, Scene, Thing};
use crate::wire;
use axum::body::{Body, to_bytes};
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::extract::{Query, State};
use axum::http::{HeaderMap, StatusCode, Uri, header};
use axum::response::{Html, IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Extension, Router};
use std::collections::HashMap;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use tokio::sync::Semaphore;

/// Most viewers at a time.
const VIEWERS: usize = 32;
/// Bytes of tiles after which figures and poses are sent again.
const BATCH: usize = 256 << 10;
/// How often it is looked, over a link, whether there is something to send.
const SHORTEST_PAUSE: Duration = Duration::from_millis(50);
/// Over a link, figures and poses are sent so often, and the last scan.
const OVER_LINK: [Duration; 2] = [Duration::from_secs(1), Duration::from_secs(2)];
/// A viewer that takes nothing for this long is given up.
const STALL: Duration = Duration::from_secs(30);
/// A viewer has nothing to say; who controls the node says it within this time.
const LARGEST_REQUEST: usize = 4096;
const REQUEST_TIME: Duration = Duration::from_secs(5);

/// A server on a thread of its own; it ends when this is dropped.
#[derive(Debug)]
pub struct Viewer(HttpServer);

/// What requests are answered from.
#[derive(Clone)]
struct Site {
    scene: Arc<Scene>,
    page: Arc<str>,
    session: u64,
    viewers: Arc<Semaphore>,
    control: Option<Arc<Control>>,
}

/// How a node is controlled over HTTP.
#[derive(Debug)]
pub struct Control {
    requests: RequestSender,
    token: Token,
}

impl Control {
    /// By those who know `token`, whose requests go to `requests`; none if the token could be guessed or not be sent.
    pub fn new(requests: RequestSender, token: &str) -> Option<Self> {
        Some(Self { requests, token: Token::new(token)? })
    }
}

impl Viewer {
    /// Serves `scene` at `address`, with port 0 at one that is free, on a page with a title; also to pages of `origins`. With `control`, the node can be controlled there.
    ///
    /// # Errors
    /// When the address is taken or not of this machine, or the system has no thread.
    pub fn start(scene: Arc<Scene>, title: &str, address: SocketAddr, origins: Vec<String>, control: Option<Control>) -> io::Result<Self> {
        HttpServer::start("viewer", address, origins, routes(scene, page::html(title), control)).map(Self)
    }

    /// Where it is.
    pub fn address(&self) -> SocketAddr {
        self.0.address()
    }
}

/// What is answered where: `page` at the root.
pub(crate) fn routes(scene: Arc<Scene>, page: String, control: Option<Control>) -> Router {
    let session = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as u64);
    let viewers = Arc::new(Semaphore::new(VIEWERS));
    let site = Site { scene, page: page.into(), session, viewers, control: control.map(Arc::new) };
    let routes = Router::new().route("/", get(page_of)).route("/socket", get(socket)).route("/health", get(health));
    let requests = ["/save", "/mesh", "/pause", "/resume", "/reset", "/load", "/explore", "/explore/pause", "/explore/home"];
    requests.into_iter().fold(routes, |routes, path| routes.route(path, post(self::control))).with_state(site)
}

/// The page. Its own scripts are those with a word that nobody can know before, so that nothing else in it is ever run.
async fn page_of(State(site): State<Site>) -> Response {
    let nonce = unknown_word();
    let policy = format!(
        "default-src 'none'; script-src 'nonce-{nonce}'; style-src 'unsafe-inline'; img-src data:; connect-src 'self'; base-uri 'none'; form-action 'none'; \
         frame-ancestors 'none'"
    );
    let page = site.page.replacen("<script>", &format!("<script nonce=\"{nonce}\">"), 1);
    ([(header::CONTENT_SECURITY_POLICY, policy)], Html(page)).into_response()
}

async fn health(State(site): State<Site>) -> Response {
    let figures = site.scene.latest(Thing::Statistics).map(|message| message.slice(wire::HEAD..));
    ([(header::CONTENT_TYPE, "application/json")], figures.unwrap_or_else(|| "{}".into())).into_response()
}

/// Asks the node for what the path says.
async fn control(State(site): State<Site>, headers: HeaderMap, uri: Uri, body: Body) -> Response {
    let Some(control) = site.control.clone() else {
        return (StatusCode::FORBIDDEN, "this node is not controlled over HTTP: start it with a token\n").into_response();
    };
    if !control.token.is_in(&headers) {
        return (StatusCode::UNAUTHORIZED, "send the token: Authorization: Bearer TOKEN\n").into_response();
    }
    let Ok(body) = tokio::time::timeout(REQUEST_TIME, to_bytes(body, LARGEST_REQUEST)).await else {
        return (StatusCode::REQUEST_TIMEOUT, "the request does not end\n").into_response();
    };
    let Ok(body) = body else { return (StatusCode::PAYLOAD_TOO_LARGE, "the request is too long\n").into_response() };
    let request = match uri.path() {
        "/save" => Request::Save,
        "/mesh" => Request::Mesh,
        "/pause" => Request::Pause(true),
        "/resume" => Request::Pause(false),
        "/explore" => Request::Explore(true),
        "/explore/pause" => Request::Explore(false),
        "/explore/home" => Request::ReturnHome,
        "/load" => Request::Load(String::from_utf8_lossy(&body).trim().into()),
        _ => Request::Reset,
    };
    match tokio::task::spawn_blocking(move || control.requests.ask(request)).await {
        Ok(Some(Answered::Done(Ok(words)) | Answered::Loaded(Ok(words)))) => (StatusCode::OK, words + "\n").into_response(),
        Ok(Some(Answered::Done(Err(words)) | Answered::Loaded(Err((_, words))))) => (StatusCode::CONFLICT, words + "\n").into_response(),
        _ => (StatusCode::SERVICE_UNAVAILABLE, "the node does not answer\n").into_response(),
    }
}

async fn socket(
    State(site): State<Site>,
    Extension(place): Extension<Place>,
    Query(had): Query<HashMap<String, String>>,
    upgrade: WebSocketUpgrade,
) -> Response {
    let Ok(permit) = Arc::clone(&site.viewers).try_acquire_owned() else {
        return (StatusCode::SERVICE_UNAVAILABLE, format!("{VIEWERS} viewers are attached already; close one\n")).into_response();
    };
    let number = |key: &str| had.get(key).and_then(|text| text.parse::<u64>().ok());
    let resumed = number("session") == Some(site.session);
    let have = Have { tiles: number("tiles").filter(|_| resumed).unwrap_or(0), others: 0 };
    let upgrade = upgrade.max_message_size(LARGEST_REQUEST).max_frame_size(LARGEST_REQUEST);
    upgrade.on_upgrade(move |socket| async move {
        // An error is a viewer that has gone.
        let _ = match site.scene.link() {
            None => show(socket, &site, have, resumed).await,
            Some(link) => show_over(link, socket, &site).await,
        };
        drop((permit, place));
    })
}

/// Sends a viewer what it does not have, as fast as it takes it.
async fn show(mut socket: WebSocket, site: &Site, mut have: Have, resumed: bool) -> Result<(), axum::Error> {
    let mut changes = site.scene.changes();
    // A page that knows how much is there draws it once, when it has come.
    let there = site.scene.news(Have { tiles: have.tiles, others: u64::MAX }, usize::MAX).have.tiles;
    let hello = wire::hello(site.session, resumed, there);
    send(&mut socket, Message::Binary(hello.into())).await?;
    loop {
        changes.borrow_and_update();
        let news = site.scene.news(have, BATCH);
        have = news.have;
        let is_idle = news.messages.is_empty();
        for (_, message) in news.messages {
            send(&mut socket, Message::Binary(message)).await?;
        }
        if is_idle {
            tokio::select! {
                changed = changes.changed() => if changed.is_err() { return Ok(()) },
                said = socket.recv() => match said {
                    None | Some(Err(_) | Ok(Message::Close(_))) => return Ok(()),
                    Some(Ok(_)) => {}
                },
            }
        }
    }
}

/// Sends a viewer what it does not have over a link: now and then the latest of what is small, and between tiles by their importance, as the link is free for them.
async fn show_over(link: &Link, mut socket: WebSocket, site: &Site) -> Result<(), axum::Error> {
    let (mut others, mut sent) = (0, HashMap::new());
    let [mut next, mut next_scan] = [Instant::now(); 2];
    let hello = wire::hello(site.session, false, site.scene.news(Have { tiles: 0, others: u64::MAX }, usize::MAX).have.tiles);
    link.send(hello.len(), 1);
    send(&mut socket, Message::Binary(hello.into())).await?;
    loop {
        let now = Instant::now();
        if next <= now {
            next = now + OVER_LINK[0];
            let news = site.scene.news(Have { tiles: u64::MAX, others }, 0);
            others = news.have.others;
            for (_, message) in news.messages {
                if wire::is_scan(&message) {
                    if next_scan > now {
                        continue;
                    }
                    next_scan = now + OVER_LINK[1];
                }
                link.send(message.len(), 1);
                send(&mut socket, Message::Binary(message)).await?;
            }
        }
        let tile = if link.may_send(Urgency::Later) { site.scene.most_important(&sent) } else { None };
        if let Some((place, number, message)) = tile {
            sent.insert(place, number);
            link.send(message.len(), 1);
            send(&mut socket, Message::Binary(message)).await?;
            continue;
        }
        let pause = link.wait(Urgency::Later, Instant::now()).clamp(SHORTEST_PAUSE, OVER_LINK[0]);
        tokio::select! {
            () = tokio::time::sleep(pause) => {}
            said = socket.recv() => match said {
                None | Some(Err(_) | Ok(Message::Close(_))) => return Ok(()),
                Some(Ok(_)) => {}
            },
        }
    }
}

/// Sends a message; a client that does not take it in time is dropped.
pub(crate) async fn send(socket: &mut WebSocket, message: Message) -> Result<(), axum::Error> {
    match tokio::time::timeout(STALL, socket.send(message)).await {
        Ok(sent) => sent,
        Err(stalled) => {
            tracing::warn!("a client took nothing for {} s: its connection is closed", STALL.as_secs());
            Err(axum::Error::new(stalled))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{Read, Write};
    use std::net::TcpStream;
    use tungstenite::client::IntoClientRequest;

    fn viewer() -> (Arc<Scene>, Viewer) {
        let scene = Arc::new(Scene::default());
        let viewer = Viewer::start(Arc::clone(&scene), "a map", ([127, 0, 0, 1], 0).into(), Vec::new(), None).unwrap();
        (scene, viewer)
    }

    fn asked(viewer: &Viewer, path: &str, headers: &str) -> String {
        let mut stream = TcpStream::connect(viewer.address()).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        write!(stream, "GET {path} HTTP/1.1\r\n{headers}\r\nConnection: close\r\n\r\n").unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer
    }

    fn attached(viewer: &Viewer, query: &str) -> tungstenite::WebSocket<TcpStream> {
        let stream = TcpStream::connect(viewer.address()).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        let request = format!("ws://{}/socket{query}", viewer.address()).into_client_request().unwrap();
        tungstenite::client(request, stream).unwrap().0
    }

    fn next(socket: &mut tungstenite::WebSocket<TcpStream>) -> (u32, u64, Vec<u8>) {
        let message = socket.read().unwrap().into_data();
        let number = u64::from_le_bytes(message[4..12].try_into().unwrap());
        (u32::from_le_bytes(message[..4].try_into().unwrap()), number, message[12..].to_vec())
    }

    #[test]
    fn strangers_are_refused() {
        let (scene, viewer) = viewer();
        scene.put([(Thing::Statistics, wire::statistics("{\"scans\":3}"))]);
        let page = asked(&viewer, "/", "Host: localhost:1");
        let nonce = page.split_once("script-src 'nonce-").and_then(|(_, rest)| rest.split_once('\'')).unwrap().0;
        assert!(page.contains("<title>a map") && page.contains(&format!("<script nonce=\"{nonce}\">")) && !page.contains("<script>"), "{page}");
        assert!(!asked(&viewer, "/", "Host: localhost:1").contains(nonce), "a word that can be known before");
        assert!(asked(&viewer, "/health", "Host: 127.0.0.1").ends_with("{\"scans\":3}"));
        assert!(asked(&viewer, "/", "Host: evil.example").starts_with("HTTP/1.1 403"));
        assert!(asked(&viewer, "/health", "Host: [::1]:80\r\nOrigin: http://evil.example").starts_with("HTTP/1.1 403"));
        for (origin, is_own) in [("http://evil.example".to_owned(), false), (format!("http://{}", viewer.address()), true)] {
            let mut request = format!("ws://{}/socket", viewer.address()).into_client_request().unwrap();
            request.headers_mut().insert("Origin", origin.parse().unwrap());
            assert_eq!(tungstenite::client(request, TcpStream::connect(viewer.address()).unwrap()).is_ok(), is_own, "{origin}");
        }
        assert!(asked(&viewer, "/nothing", "Host: localhost").starts_with("HTTP/1.1 404"));
    }

    #[test]
    fn viewers_come_and_go_and_one_that_comes_back_gets_what_it_lacks() {
        let (scene, viewer) = viewer();
        let tile = |x: i32| (Thing::Tile([x, 0, 0]), wire::tile(0, [x, 0, 0], 1, voxelastic::surface::Mesh::default()));
        scene.put([tile(1), tile(2)]);
        let mut one = attached(&viewer, "");
        let (kind, _, hello) = next(&mut one);
        let hello: serde_json::Value = serde_json::from_slice(&hello).unwrap();
        assert!(kind == 0 && hello["resumed"] == false);
        let numbers = [next(&mut one).1, next(&mut one).1];
        assert_eq!(numbers, [1, 2]);
        // Garbage has no effect, too much of it ends the connection and nothing else.
        one.send(tungstenite::Message::binary(vec![7; 100])).unwrap();
        one.send(tungstenite::Message::text("{\"reset\":true}")).unwrap();
        scene.put([tile(3)]);
        assert_eq!(next(&mut one).1, 3);
        one.send(tungstenite::Message::binary(vec![7; 100_000])).unwrap();
        assert!(one.read().is_err() || one.read().is_err());
        drop(one);
        let mut raw = TcpStream::connect(viewer.address()).unwrap();
        raw.write_all(&[0xff; 5000]).unwrap();
        scene.put([tile(1)]);
        let mut again = attached(&viewer, &format!("?session={}&tiles=2", hello["session"].as_str().unwrap()));
        assert!(String::from_utf8(next(&mut again).2).unwrap().contains("\"resumed\":true"));
        assert_eq!([next(&mut again).1, next(&mut again).1], [3, 4], "tile 2 is as it was");
        let mut stranger = attached(&viewer, "?session=1&tiles=2");
        assert!(String::from_utf8(next(&mut stranger).2).unwrap().contains("\"resumed\":false"));
        assert_eq!([next(&mut stranger).1, next(&mut stranger).1, next(&mut stranger).1], [2, 3, 4]);
    }

    #[test]
    fn a_viewer_that_reads_nothing_keeps_nobody_waiting() {
        let (scene, viewer) = viewer();
        let stuck = attached(&viewer, "");
        let mut one = attached(&viewer, "");
        next(&mut one);
        // Far more than sockets hold, of which the latest of each tile is kept.
        for round in 0..200u64 {
            scene.put((0..8).map(|x| (Thing::Tile([x, 0, 0]), vec![0; 100_000])));
            let seen = scene.size();
            assert_eq!(seen, (8, 800_000), "round {round}");
        }
        while next(&mut one).1 < 1600 {}
        drop(stuck);
    }

    #[test]
    fn over_a_link_viewers_get_what_is_near_first_and_no_more_than_it_carries() {
        let link = Arc::new(Link::new(100_000.0));
        let scene = Arc::new(Scene::over(Some(Arc::clone(&link))));
        let viewer = Viewer::start(Arc::clone(&scene), "a map", ([127, 0, 0, 1], 0).into(), Vec::new(), None).unwrap();
        scene.focus([30, 0, 0]);
        let tile = |x: i32| [&1u32.to_le_bytes()[..], &[0; 8], &x.to_le_bytes(), &[0; 9_984]].concat();
        scene.put((0..40).map(|x| (Thing::Tile([x, 0, 0]), tile(x))));
        let mut one = attached(&viewer, "");
        next(&mut one);
        let begin = Instant::now();
        let places = [(); 20].map(|()| i32::from_le_bytes(next(&mut one).2[..4].try_into().unwrap()));
        // Twenty of 10 kB: the last is sent once those before it were carried.
        assert!((1.8..4.0).contains(&begin.elapsed().as_secs_f64()), "{:?}", begin.elapsed());
        assert!(places.iter().enumerate().all(|(k, x)| (x - 30).unsigned_abs() as usize <= k.div_ceil(2) + 1), "{places:?}");
        assert!((200_000..230_000).contains(&link.sent()), "{}", link.sent());
    }

    #[test]
    fn only_those_who_know_the_token_control_the_node() {
        let (sender, requests) = std::sync::mpsc::channel();
        let token = "correct-horse-battery";
        assert!(
            Control::new(RequestSender::new(sender.clone()), "short").is_none()
                && Control::new(RequestSender::new(sender.clone()), "sixteen or more but spaces").is_none()
        );
        let control = Control::new(RequestSender::new(sender), token);
        let viewer = Viewer::start(Arc::default(), "a map", ([127, 0, 0, 1], 0).into(), Vec::new(), control).unwrap();
        let node = std::thread::spawn(move || {
            let pending: crate::ros::services::Pending = requests.recv().unwrap();
            assert_eq!(pending.request, Request::Pause(true));
            pending.answer(Answered::Done(Ok("paused".into())));
            requests.recv().map(|pending| pending.request)
        });
        let post = |path: &str, headers: &str| {
            let mut stream = TcpStream::connect(viewer.address()).unwrap();
            stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
            write!(stream, "POST {path} HTTP/1.1\r\nHost: localhost\r\nContent-Length: 0\r\n{headers}Connection: close\r\n\r\n").unwrap();
            let mut answer = String::new();
            stream.read_to_string(&mut answer).unwrap();
            answer
        };
        let bearer = |token: &str| format!("Authorization: Bearer {token}\r\n");
        for wrong in [String::new(), bearer(""), bearer("correct-horse-batter"), bearer("correct-horse-batterx"), bearer("correct-horse-battery1")] {
            assert!(post("/reset", &wrong).starts_with("HTTP/1.1 401"), "{wrong}");
        }
        assert!(post("/reset", &(bearer(token) + "Origin: http://evil.example\r\n")).starts_with("HTTP/1.1 403"));
        assert!(post("/nothing", &bearer(token)).starts_with("HTTP/1.1 404"));
        let done = post("/pause", &bearer(token));
        assert!(done.starts_with("HTTP/1.1 200") && done.ends_with("paused\n"), "{done}");
        assert!(asked(&viewer, "/pause", "Host: localhost").starts_with("HTTP/1.1 405"));
        drop(viewer);
        assert!(node.join().unwrap().is_err(), "nothing else was asked");
    }

    #[test]
    fn there_are_not_too_many_viewers() {
        let (_scene, viewer) = viewer();
        let all: Vec<_> = (0..VIEWERS).map(|_| attached(&viewer, "")).collect();
        let stream = TcpStream::connect(viewer.address()).unwrap();
        assert!(tungstenite::client(format!("ws://{}/socket", viewer.address()), stream).is_err());
        drop(all);
    }
}
