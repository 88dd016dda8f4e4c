//! Anything that can be sent to the servers: mutated requests, random and mutated frames, huge ones, wrong tokens, half of everything. They answer or close, and
//! others are served as before.

#![cfg(target_os = "linux")]

use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpStream};
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use voxelastic_live::ros::services::{Pending, RequestSender};
use voxelastic_live::scene::{Scene, Thing};
use voxelastic_live::viewer::{Control, Viewer};
use voxelastic_live::wire;
use voxelastic_testing::PATIENCE;

/// Connections of each kind.
const ROUNDS: usize = 400;
/// What the process may grow by, bytes: what is sent to it is a hundred times as much.
const MOST_GROWTH: usize = 24 << 20;
/// Of a message that does not end, each of 131 kB. The servers take no more than 4 kB and 64 kB.
const PARTS: usize = 800;
const TOKEN: &str = "correct-horse-battery";

/// Numbers that look random.
struct Random(u64);

impl Random {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % n.max(1)
    }

    fn bytes(&mut self, n: usize) -> Vec<u8> {
        (0..n).map(|_| self.below(256) as u8).collect()
    }

    /// Some bytes changed, left out, or doubled.
    fn mutated(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut bytes = bytes.to_vec();
        for _ in 0..=self.below(4) {
            let at = self.below(bytes.len());
            match self.below(4) {
                0 => bytes.truncate(at),
                1 => bytes.iter_mut().skip(at).take(1).for_each(|byte| *byte = b'\n'),
                2 => bytes.splice(at..at, b"\xff\0\r\n".repeat(3)).for_each(drop),
                _ => bytes.iter_mut().skip(at).take(1).for_each(|byte| *byte ^= 1 << (at % 8)),
            }
        }
        bytes
    }

    /// A frame as a client sends it, or nearly.
    fn frame(&mut self) -> Vec<u8> {
        let (opcode, length) = (self.below(16) as u8, [0, 1, 5, 125, 126, 4000, 5000, 70_000][self.below(8)]);
        let is_whole = self.below(4) > 0;
        let is_masked = self.below(8) > 0;
        let reserved = if self.below(8) == 0 { self.below(8) as u8 } else { 0 };
        let mut frame = vec![u8::from(self.below(4) > 0) << 7 | reserved << 4 | opcode];
        // What it says of its length may be wrong: up to more than there is.
        let said = if is_whole { length as u64 } else { [u64::MAX, 1 << 62, 1 << 32, 1 << 20, 3][self.below(5)] };
        let mask = u8::from(is_masked) << 7;
        match said {
            0..126 => frame.push(mask | said as u8),
            126..65_536 if self.below(8) > 0 => frame.extend([vec![mask | 126], (said as u16).to_be_bytes().to_vec()].concat()),
            _ => frame.extend([vec![mask | 127], said.to_be_bytes().to_vec()].concat()),
        }
        frame.extend(self.bytes(if is_masked { 4 } else { 0 }));
        frame.extend(self.bytes(length));
        frame
    }
}

fn handshake(path: &str, protocol: &str) -> String {
    format!(
        "GET {path} HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\
         Sec-WebSocket-Version: 13\r\n{protocol}\r\n"
    )
}

fn connected(address: SocketAddr) -> TcpStream {
    let stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(Duration::from_millis(200))).unwrap();
    stream.set_write_timeout(Some(Duration::from_secs(5))).unwrap();
    stream
}

/// Reads up to the end of the answer's head; false if the connection ends before.
fn is_upgraded(stream: &mut TcpStream) -> bool {
    let (mut head, mut byte) = (Vec::new(), [0]);
    while !head.ends_with(b"\r\n\r\n") && head.len() < 4096 {
        match stream.read(&mut byte) {
            Ok(1) => head.push(byte[0]),
            _ => return false,
        }
    }
    head.starts_with(b"HTTP/1.1 101")
}

/// A connection whose request is as it should be. The server may take a moment to see that those before are gone.
fn upgraded(address: SocketAddr, request: &str) -> TcpStream {
    let begin = Instant::now();
    loop {
        let mut stream = connected(address);
        stream.write_all(request.as_bytes()).unwrap();
        if is_upgraded(&mut stream) {
            return stream;
        }
        assert!(begin.elapsed() < PATIENCE, "a request as it should be is not answered");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Sends what it can, and reads what comes for a moment; whether the server has closed.
fn is_closed_after(stream: &mut TcpStream, sent: &[u8]) -> bool {
    if stream.write_all(sent).is_err() {
        return true;
    }
    let mut buffer = [0; 4096];
    stream.set_read_timeout(Some(Duration::from_millis(5))).unwrap();
    loop {
        match stream.read(&mut buffer) {
            Ok(0) => return true,
            Ok(_) => {}
            Err(error) => return !matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut),
        }
    }
}

/// One test at a time: memory and threads are those of the whole process.
fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Resident memory, bytes, and threads.
fn usage() -> (usize, usize) {
    let text = std::fs::read_to_string("/proc/self/status").unwrap();
    let number = |key: &str| text.lines().find_map(|line| line.strip_prefix(key)?.split_whitespace().next()?.parse::<usize>().ok()).unwrap();
    (number("VmRSS:") << 10, number("Threads:"))
}

/// Sends garbage to a server that speaks WebSocket at a path, with the lines that its handshake needs; returns how many connections it closed and how many were still open.
fn assault(address: SocketAddr, path: &str, protocol: &str, random: &mut Random) -> [usize; 2] {
    let mut ends = [0; 2];
    for round in 0..ROUNDS {
        let request = handshake(path, protocol);
        if round % 4 == 3 {
            let sent = random.mutated(request.as_bytes());
            ends[usize::from(!is_closed_after(&mut connected(address), &sent))] += 1;
            continue;
        }
        let mut stream = upgraded(address, &request);
        let is_closed = (0..=random.below(6)).any(|_| {
            let frame = random.frame();
            let cut = if random.below(6) == 0 { random.below(frame.len()) } else { frame.len() };
            is_closed_after(&mut stream, &frame[..cut])
        });
        ends[usize::from(!is_closed)] += 1;
        if random.below(2) == 0 {
            let _ = stream.shutdown(Shutdown::Write);
        }
    }
    // A message that never ends, and one question after the other by who reads no answers.
    for opcode in [2u8, 9] {
        let mut stream = upgraded(address, &handshake(path, protocol));
        let part = |first: u8| [vec![first, 0x80 | 125, 1, 2, 3, 4], vec![7; 125]].concat();
        let parts = if opcode == 9 { part(0x89).repeat(1000) } else { part(0).repeat(1000) };
        let begin = if opcode == 9 { part(0x89) } else { part(opcode) };
        stream.set_write_timeout(Some(Duration::from_millis(500))).unwrap();
        let sent = stream.write_all(&begin).is_ok().then(|| (0..PARTS).take_while(|_| stream.write_all(&parts).is_ok()).count());
        assert!(opcode == 9 || sent < Some(PARTS), "a message of 105 MB was taken");
    }
    ends
}

fn asked(address: SocketAddr, request: &str) -> String {
    let mut stream = connected(address);
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    let mut answer = Vec::new();
    // A server that refuses to read on resets the connection.
    let _ = stream.read_to_end(&mut answer);
    String::from_utf8_lossy(&answer).into_owned()
}

#[test]
fn the_viewers_server_answers_or_closes() {
    let _alone = alone();
    let (sender, requests) = channel::<Pending>();
    let control = Control::new(RequestSender::new(sender), TOKEN);
    let scene = Arc::new(Scene::default());
    scene.put([(Thing::Statistics, wire::statistics("{\"scans\":3}"))]);
    scene.put((0..20).map(|x| (Thing::Tile([x, 0, 0]), vec![1; 10_000])));
    let viewer = Viewer::start(Arc::clone(&scene), "a map", ([127, 0, 0, 1], 0).into(), Vec::new(), control).unwrap();
    let (address, mut random) = (viewer.address(), Random(1));
    // What is allocated once is there before it is measured.
    assault(address, "/socket", "", &mut random);
    let (before, threads) = usage();
    let paths = ["/socket", "/socket?session=1&tiles=99999999999999999999999", "/socket?tiles=-1&session=%ff%00", "/socket?session=&=&&&tiles"];
    let mut closed = 0;
    for path in paths {
        closed += assault(address, path, "", &mut random)[0];
    }
    assert!(closed > ROUNDS, "{closed} were closed");
    // Requests that only those may make who know the token.
    let right = format!("Bearer {TOKEN}");
    for round in 0..ROUNDS {
        let path = ["/save", "/reset", "/load", "/pause"][round % 4];
        let length = [0, 5, 4096, 100_000][random.below(4)];
        let token = match round % 3 {
            0 => String::from_utf8_lossy(&random.mutated(right.as_bytes())).replace(['\r', '\n', '\0'], "?"),
            1 => right[..random.below(right.len())].to_owned(),
            _ => format!("{right}{}", random.below(9)),
        };
        if token == right {
            continue;
        }
        let head =
            format!("POST {path} HTTP/1.1\r\nHost: localhost\r\nAuthorization: {token}\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n");
        let answer = asked(address, &(head + &"x".repeat(length)));
        assert!(!answer.starts_with("HTTP/1.1 2"), "{path} by {token:?}: {answer}");
    }
    let length = 1u64 << 40;
    let head = format!("POST /load HTTP/1.1\r\nHost: localhost\r\nAuthorization: {right}\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n");
    assert!(asked(address, &(head + &"x".repeat(5000))).starts_with("HTTP/1.1 413"));
    assert!(requests.try_recv().is_err(), "nobody asked anything of the node");
    // All places of viewers are free again, and a viewer gets all of the map.
    let begin = Instant::now();
    let mut all = Vec::new();
    while all.len() < 32 {
        assert!(begin.elapsed() < PATIENCE, "only {} viewers have a place", all.len());
        let stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        match tungstenite::client(format!("ws://{address}/socket"), stream) {
            Ok((socket, _)) => all.push(socket),
            Err(_) => std::thread::sleep(Duration::from_millis(100)),
        }
    }
    for socket in &mut all {
        // The first message, figures, and tiles.
        let bytes: usize = (0..22).map(|_| socket.read().unwrap().into_data().len()).sum();
        assert!(bytes > 200_000, "{bytes}");
    }
    drop(all);
    let (after, threads_after) = usage();
    assert!(after < before + MOST_GROWTH, "from {} to {} MB", before >> 20, after >> 20);
    // Other threads are those that wait for the node's answers, and end after a while.
    assert!(threads_after <= threads + 8, "from {threads} to {threads_after} threads");
    assert!(asked(address, "GET /health HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n").ends_with("{\"scans\":3}"));
}

#[cfg(feature = "foxglove")]
#[test]
fn the_foxglove_server_answers_or_closes() {
    use voxelastic_live::ros::foxglove::FoxgloveServer;
    use voxelastic_live::ros::middleware::{Delivery, TopicProfile};
    let _alone = alone();
    let server = FoxgloveServer::start("voxelastic", ([127, 0, 0, 1], 0).into(), Vec::new()).unwrap();
    let profile = TopicProfile { name: "/path".into(), kind: "nav_msgs/msg/Path".into(), delivery: Delivery::Latched, depth: 1 };
    let mut sink = server.advertise(&profile).unwrap();
    sink.publish(&[0, 1, 0, 0, 5, 0, 0, 0]).unwrap();
    let protocol = "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n";
    let mut random = Random(2);
    // What is not given back at all grows with each assault.
    let mut used = Vec::new();
    let settles = (0..6).any(|_| {
        assault(server.address(), "/", protocol, &mut random);
        used.push(usage().0);
        matches!(used[..], [.., before, after] if after < before + MOST_GROWTH / 4)
    });
    assert!(settles, "memory grows without end: {:?} MB", used.iter().map(|bytes| bytes >> 20).collect::<Vec<_>>());
    // Others are served as before.
    let _stream = upgraded(server.address(), &handshake("/", protocol));
    sink.publish(&[0, 1, 0, 0, 6, 0, 0, 0]).unwrap();
}
