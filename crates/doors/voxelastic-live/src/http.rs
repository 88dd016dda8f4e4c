//! The one place where this program listens for HTTP and WebSockets: who may ask, how many at a time, how much of a request there may be, and for how long.
//!
//! Scans come before those who look: connections are few enough that descriptors remain for data and for saving.

use crate::worker::lower_priority;
use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Router};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use std::hash::{BuildHasher, RandomState};
use std::io;
use std::net::{IpAddr, SocketAddr, TcpListener};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, oneshot};

/// Most connections at a time, and the part of the process's descriptors that they may take.
const CONNECTIONS: usize = 64;
const SHARE_OF_DESCRIPTORS: u64 = 8;
/// A request's head comes within this time, and with no more than this many bytes.
const HEAD_TIME: Duration = Duration::from_secs(5);
const LARGEST_HEAD: usize = 16 << 10;
/// A request is answered, and the answer taken, within this time; a node may take two minutes to answer.
const LONGEST: Duration = Duration::from_secs(150);
/// Shorter tokens could be guessed.
const SHORTEST_TOKEN: usize = 16;
/// Between attempts to take a connection when the system refuses.
const PAUSE: Duration = Duration::from_millis(100);
/// After a connection that is turned away: whoever opens one after the other costs no more than so many.
const BREATH: Duration = Duration::from_millis(1);
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

/// A word that those know who may change something.
#[derive(Debug)]
pub(crate) struct Token(String);

impl Token {
    /// None if it could be guessed or not be sent.
    pub(crate) fn new(token: &str) -> Option<Self> {
        let is_token = token.len() >= SHORTEST_TOKEN && token.bytes().all(|byte| byte.is_ascii_graphic());
        is_token.then(|| Self(token.to_owned()))
    }

    /// Whether a request has it. The time that takes does not say how much of it is right.
    pub(crate) fn is_in(&self, headers: &HeaderMap) -> bool {
        let sent = headers.get(header::AUTHORIZATION).map(|value| value.as_bytes().strip_prefix(b"Bearer ").unwrap_or_default()).unwrap_or_default();
        let differs = sent.iter().zip(self.0.bytes()).fold(0, |differs, (a, b)| differs | (a ^ b));
        differs == 0 && sent.len() == self.0.len()
    }
}

/// A word that nobody can know before.
pub(crate) fn unknown_word() -> String {
    format!("{:016x}{:016x}", RandomState::new().hash_one(0), RandomState::new().hash_one(1))
}

/// Who may ask.
#[derive(Clone, Debug)]
struct Allowed {
    origins: Arc<[String]>,
    /// Of this machine.
    names: Arc<[String]>,
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
        let routes = guarded(routes, origins);
        let runtime = tokio::runtime::Builder::new_current_thread().enable_io().enable_time().build()?;
        let (stop, stopped) = oneshot::channel();
        let thread = std::thread::Builder::new().name(name.to_owned()).spawn(move || {
            lower_priority();
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
            tokio::time::sleep(BREATH).await;
            continue;
        };
        tokio::spawn(serve(stream, routes.clone(), place));
    }
}

/// Answers a client until one of both has enough.
async fn serve(stream: impl AsyncRead + AsyncWrite + Unpin + Send + 'static, routes: Router, place: OwnedSemaphorePermit) {
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(HEAD_TIME).max_buf_size(LARGEST_HEAD);
    let routes = TowerToHyperService::new(routes.layer(Extension(Place(Arc::new(place)))));
    let connection = http.serve_connection(TokioIo::new(stream), routes).with_upgrades();
    // An error is a client that has gone, or one that took too long.
    drop(tokio::time::timeout(LONGEST, connection).await);
}

/// What a client is answered that sends some bytes, `then` others once it has an answer, and then nothing more: the server without its network, for fuzzing.
#[cfg(feature = "fuzzing")]
pub(crate) fn answered(routes: Router, sent: &[u8], then: Option<&[u8]>) -> Vec<u8> {
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    let Ok(runtime) = tokio::runtime::Builder::new_current_thread().enable_time().build() else { return Vec::new() };
    let (client, server) = tokio::io::duplex(1 << 16);
    let (mut answers, mut requests) = tokio::io::split(client);
    let mut answer = Vec::new();
    runtime.block_on(async {
        let Ok(place) = Arc::new(Semaphore::new(1)).try_acquire_owned() else { return };
        tokio::spawn(serve(server, guarded(routes, Vec::new()), place));
        let _ = requests.write_all(sent).await;
        if then.is_some() {
            let _ = answers.read_buf(&mut answer).await;
        }
        let send = async {
            let _ = requests.write_all(then.unwrap_or_default()).await;
            let _ = requests.shutdown().await;
        };
        let _ = tokio::join!(send, answers.read_to_end(&mut answer));
    });
    answer
}

/// Routes that only those who may are shown.
fn guarded(routes: Router, origins: Vec<String>) -> Router {
    routes.layer(from_fn_with_state(Allowed { origins: origins.into(), names: names().into() }, guard))
}

/// Refuses strangers, and tells browsers what pages may do with an answer.
async fn guard(State(allowed): State<Allowed>, request: Request, next: Next) -> Response {
    let mut response = if allowed.allows(request.headers()) {
        next.run(request).await
    } else {
        let words = "this map is shown at addresses, at localhost, at this machine's name and at those of known origins, to pages of its own server and of \
                     known origins (--allow-origin)\n";
        (StatusCode::FORBIDDEN, words).into_response()
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
    /// Whether a request comes from a page of this server or of a known origin, or from no page, and asks for this machine by a name that is its own: another one
    /// may be a stranger's that was made to lead here.
    fn allows(&self, headers: &HeaderMap) -> bool {
        let text = |name: header::HeaderName| headers.get(name).map(|value| value.to_str().unwrap_or_default());
        let host = text(header::HOST).unwrap_or_default();
        let is_known = |origin: &str| origin.strip_prefix("http://") == Some(host) || self.origins.iter().any(|known| known == origin);
        text(header::ORIGIN).is_none_or(is_known) && self.is_here(host)
    }

    /// Whether a host, perhaps with a port, is an address, a name of this machine, or that of a known origin.
    fn is_here(&self, host: &str) -> bool {
        let name = name_of(host);
        let is = |known: &str| known.eq_ignore_ascii_case(name);
        let of_origin = |origin: &String| origin.split_once("://").is_some_and(|(_, host)| !host.is_empty() && is(name_of(host)));
        let is_address = name.trim_start_matches('[').trim_end_matches(']').parse::<IpAddr>().is_ok();
        is_address || is("localhost") || self.names.iter().any(|known| is(known)) || self.origins.iter().any(of_origin)
    }
}

/// A host without its port.
fn name_of(host: &str) -> &str {
    host.rsplit_once(':').filter(|(_, port)| port.parse::<u16>().is_ok()).map_or(host, |(name, _)| name)
}

/// What this machine is called, whole, by its first part, and as the local network finds it without a server of names.
fn names() -> Vec<String> {
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let name = name.trim();
    let first = name.split('.').next().unwrap_or_default();
    if first.is_empty() { Vec::new() } else { vec![name.to_owned(), first.to_owned(), format!("{first}.local")] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::routing::get;
    use std::io::{Read, Write};
    use std::net::TcpStream;
    use voxelastic_testing::PATIENCE;

    fn server(origins: &[&str]) -> HttpServer {
        server_at([127, 0, 0, 1], origins)
    }

    fn server_at(address: [u8; 4], origins: &[&str]) -> HttpServer {
        let origins = origins.iter().map(ToString::to_string).collect();
        HttpServer::start("test", (address, 0).into(), origins, Router::new().route("/", get(|| async { "the map" }))).unwrap()
    }

    fn sent(server: &HttpServer, text: &str) -> TcpStream {
        let mut stream = TcpStream::connect(("127.0.0.1", server.address().port())).unwrap();
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
            ("Host: app.example\r\nOrigin: https://app.example", true),
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

    /// Whether it is asked for at this machine or from the network: a page whose name a stranger leads here stays outside.
    #[test]
    fn a_server_answers_to_names_of_its_own() {
        for address in [[127, 0, 0, 1], [0, 0, 0, 0]] {
            let server = server_at(address, &["https://robot.example", "file://"]);
            let mut hosts = vec![("192.168.1.7:9000", true), ("[fe80::1]:80", true), ("LOCALHOST", true), ("robot.example:9000", true)];
            hosts.extend(
                ["evil.example", "evil.example:80", "localhost.evil.example", "1.2.3.4.evil.example", "robot.example.evil", "", ":80"]
                    .map(|host| (host, false)),
            );
            let names = names();
            hosts.extend(names.iter().map(|name| (name.as_str(), true)));
            for (host, is_here) in hosts {
                for origin in [String::new(), format!("\r\nOrigin: http://{host}")] {
                    let answer = asked(&server, &format!("Host: {host}{origin}"));
                    assert_eq!(answer.contains("the map"), is_here, "{address:?}, {host}{origin}: {answer}");
                }
            }
            assert!(!asked(&server, "Accept: */*").contains("the map"), "a request that names no host");
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
