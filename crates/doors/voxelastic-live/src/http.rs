//! The one place where this program listens for HTTP and WebSockets: who may ask, how many at a time, how much of a request there may be, and for how long.
//!
//! Scans come before those who look: connections are few enough that descriptors remain for data and for saving.

use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Router};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use std::io;
use std::net::{IpAddr, SocketAddr, TcpListener};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, oneshot};

/// Most connections at a time, and the part of the process's descriptors that they may take.
const CONNECTIONS: usize = 64;
const SHARE_OF_DESCRIPTORS: u64 = 8;
/// A request's head comes within this time, and with no more than this many bytes.
const HEAD_TIME: Duration = Duration::from_secs(5);
const LARGEST_HEAD: usize = 16 << 10;
/// A request is answered, and the answer taken, within this time; a node may take two minutes to answer.
const LONGEST: Duration = Duration::from_secs(150);
/// Between attempts to take a connection when the system refuses.
const PAUSE: Duration = Duration::from_millis(100);
/// Those turned away are spoken of this often.
const SAY_EVERY: Duration = Duration::from_secs(60);

/// A server on a thread of its own; it ends when this is dropped.
#[derive(Debug)]
pub(crate) struct HttpServer {
    address: SocketAddr,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

/// A connection's place among those that are allowed: who keeps a connection keeps this.
#[derive(Clone, Debug)]
pub(crate) struct Place(#[expect(dead_code, reason = "kept for what happens when it is dropped")] Arc<OwnedSemaphorePermit>);

/// Who may ask.
#[derive(Clone, Debug)]
struct Allowed {
    is_local: bool,
    origins: Arc<[String]>,
}

impl HttpServer {
    /// Serves `routes` at `address`, with port 0 at one that is free, to programs, to pages of its own, and to those of the `origins`.
    ///
    /// # Errors
    /// When the address is taken or not of this machine, or the system has no thread.
    pub(crate) fn start(name: &str, address: SocketAddr, origins: Vec<String>, routes: Router) -> io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        let address = listener.local_addr()?;
        let allowed = Allowed { is_local: address.ip().is_loopback(), origins: origins.into() };
        let routes = routes.layer(from_fn_with_state(allowed, guard));
        let runtime = tokio::runtime::Builder::new_current_thread().enable_io().enable_time().build()?;
        let (stop, stopped) = oneshot::channel();
        let thread = std::thread::Builder::new().name(name.to_owned()).spawn(move || {
            runtime.block_on(async {
                tokio::select! {
                    () = accept(listener, routes) => {}
                    _ = stopped => {}
                }
            });
        })?;
        Ok(Self { address, stop: Some(stop), thread: Some(thread) })
    }

    /// Where it is.
    pub(crate) fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for HttpServer {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// How many connections a server has.
fn connections() -> usize {
    #[cfg(unix)]
    let descriptors = rustix::process::getrlimit(rustix::process::Resource::Nofile).current.unwrap_or(u64::MAX);
    #[cfg(not(unix))]
    let descriptors = u64::MAX;
    CONNECTIONS.min((descriptors / SHARE_OF_DESCRIPTORS).max(2) as usize)
}

/// Takes connections, as many as have a place, until the runtime ends.
async fn accept(listener: TcpListener, routes: Router) {
    let Ok(listener) = tokio::net::TcpListener::from_std(listener) else { return };
    let places = Arc::new(Semaphore::new(connections()));
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(HEAD_TIME).max_buf_size(LARGEST_HEAD);
    let (mut turned_away, mut said) = (0usize, None::<Instant>);
    loop {
        let Ok((stream, from)) = listener.accept().await else {
            tokio::time::sleep(PAUSE).await;
            continue;
        };
        let Ok(place) = Arc::clone(&places).try_acquire_owned() else {
            turned_away += 1;
            if said.is_none_or(|said| said.elapsed() >= SAY_EVERY) {
                said = Some(Instant::now());
                tracing::warn!("{turned_away} connections turned away, the last from {}: {} are open already", from.ip(), connections());
            }
            continue;
        };
        let routes = TowerToHyperService::new(routes.clone().layer(Extension(Place(Arc::new(place)))));
        let connection = http.serve_connection(TokioIo::new(stream), routes).with_upgrades();
        // An error is a client that has gone, or one that took too long.
        tokio::spawn(async move { drop(tokio::time::timeout(LONGEST, connection).await) });
    }
}

/// Refuses strangers, and tells browsers what pages may do with an answer.
async fn guard(State(allowed): State<Allowed>, request: Request, next: Next) -> Response {
    let mut response = if allowed.allows(request.headers()) {
        next.run(request).await
    } else {
        (StatusCode::FORBIDDEN, "this map is shown to pages of its own server only, and to those of known origins (--allow-origin)\n").into_response()
    };
    let is_upgraded = response.status() == StatusCode::SWITCHING_PROTOCOLS;
    let headers = response.headers_mut();
    if !is_upgraded {
        // A connection has one request: one that waits for more would keep a place.
        headers.insert(header::CONNECTION, HeaderValue::from_static("close"));
    }
    headers.entry(header::CONTENT_SECURITY_POLICY).or_insert(HeaderValue::from_static("default-src 'none'; frame-ancestors 'none'"));
    headers.insert(header::X_FRAME_OPTIONS, HeaderValue::from_static("DENY"));
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    headers.insert(header::REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    headers.insert("cross-origin-resource-policy", HeaderValue::from_static("same-origin"));
    response
}

impl Allowed {
    /// Whether a request comes from a page of this server or of a known origin, or from no page. A local server is asked for by a local name: another one may be
    /// a stranger's that was made to lead here.
    fn allows(&self, headers: &HeaderMap) -> bool {
        let text = |name: header::HeaderName| headers.get(name).map(|value| value.to_str().unwrap_or_default());
        let host = text(header::HOST).unwrap_or_default();
        let is_known = |origin: &str| origin.strip_prefix("http://") == Some(host) || self.origins.iter().any(|known| known == origin);
        text(header::ORIGIN).is_none_or(is_known) && (!self.is_local || is_local(host))
    }
}

/// Whether a host, perhaps with a port, is an address or `localhost`.
fn is_local(host: &str) -> bool {
    let name = host.rsplit_once(':').filter(|(_, port)| port.parse::<u16>().is_ok()).map_or(host, |(name, _)| name);
    name == "localhost" || name.trim_start_matches('[').trim_end_matches(']').parse::<IpAddr>().is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::routing::get;
    use std::io::{Read, Write};
    use std::net::TcpStream;
    use voxelastic_testing::PATIENCE;

    fn server(origins: &[&str]) -> HttpServer {
        let origins = origins.iter().map(ToString::to_string).collect();
        HttpServer::start("test", ([127, 0, 0, 1], 0).into(), origins, Router::new().route("/", get(|| async { "the map" }))).unwrap()
    }

    fn sent(server: &HttpServer, text: &str) -> TcpStream {
        let mut stream = TcpStream::connect(server.address()).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        // One that is turned away may be closed already.
        let _ = stream.write_all(text.as_bytes());
        stream
    }

    fn answer(mut stream: TcpStream) -> String {
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        String::from_utf8_lossy(&answer).into_owned()
    }

    fn asked(server: &HttpServer, headers: &str) -> String {
        answer(sent(server, &format!("GET / HTTP/1.1\r\n{headers}\r\n\r\n")))
    }

    #[test]
    fn pages_of_strangers_are_refused_and_those_of_known_origins_are_not() {
        let server = server(&["https://app.example"]);
        for (headers, is_allowed) in [
            ("Host: localhost:1", true),
            ("Host: 127.0.0.1", true),
            ("Host: [::1]:80\r\nOrigin: http://[::1]:80", true),
            ("Host: localhost\r\nOrigin: https://app.example", true),
            ("Host: evil.example", false),
            ("Host: evil.example\r\nOrigin: https://app.example", false),
            ("Host: localhost\r\nOrigin: http://evil.example", false),
            ("Host: localhost\r\nOrigin: https://app.example.evil", false),
            ("Host: localhost\r\nOrigin: null", false),
            ("Host: localhost\r\nOrigin: http://localhost:8080", false),
        ] {
            let answer = asked(&server, headers);
            assert_eq!(answer.starts_with("HTTP/1.1 200"), is_allowed, "{headers}: {answer}");
            assert_eq!(answer.contains("the map"), is_allowed);
            assert!(
                ["x-frame-options: DENY", "content-security-policy: default-src 'none'", "nosniff"].iter().all(|line| answer.contains(line)),
                "{answer}"
            );
        }
    }

    #[test]
    fn half_requests_keep_nobody_out_for_long() {
        let server = server(&[]);
        // Twice as many as there are places: each waits for the rest of its head, or is turned away at once.
        let halves: Vec<_> = (0..2 * CONNECTIONS).map(|_| sent(&server, "GET / HTTP/1.1\r\nHost: localhost\r\nX-A: ")).collect();
        let begin = Instant::now();
        while !asked(&server, "Host: localhost").ends_with("the map") {
            assert!(begin.elapsed() < PATIENCE, "half requests keep others out");
            std::thread::sleep(Duration::from_millis(50));
        }
        // The server ends all of them by itself.
        halves.into_iter().for_each(|half| drop(answer(half)));
    }

    #[test]
    fn heads_have_a_size() {
        let server = server(&[]);
        let long = "x".repeat(2 * LARGEST_HEAD);
        assert!(!asked(&server, &format!("Host: localhost\r\nX-A: {long}")).contains("the map"));
        assert!(asked(&server, "Host: localhost").contains("the map"));
    }
}
