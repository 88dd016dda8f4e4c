//! All attacks of the network at once, while a node maps: no scan is lost, the time is what it was, and memory is bounded. All of it on the loopback interface.

use crate::{Finished, voxelastic};
use rustix::process::{Pid, Signal, kill_process};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream, UdpSocket};
use std::path::Path;
use std::process::{Child, Stdio};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use voxelastic_testing::packets;

/// Attackers, each with so many connections that it opens again when they are closed.
const ATTACKERS: usize = 4;
const CONNECTIONS: usize = 275;
/// A pause after each connection.
const PAUSE: Duration = Duration::from_millis(2);
/// An attack is over by itself then.
const LONGEST: Duration = Duration::from_secs(300);
/// Turns that a sensor sends.
const TURNS: f64 = 80.5;

/// What a client of a kind sends, and reads nothing of what it gets: half of a request, and sockets of the viewer and of Foxglove that ask for everything.
fn request(kind: usize) -> Vec<u8> {
    let upgrade = |path: &str| {
        format!(
            "GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\
             Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n"
        )
        .into_bytes()
    };
    match kind {
        0 | 1 => b"GET / HTTP/1.1\r\nHost: localhost\r\nX-A: ".to_vec(),
        2 => upgrade("/socket"),
        _ => {
            let subscriptions: Vec<_> = (1..12).map(|id| serde_json::json!({ "id": id, "channelId": id })).collect();
            let text = serde_json::json!({ "op": "subscribe", "subscriptions": subscriptions }).to_string();
            let head = [&[0x81, 0xfe][..], &(text.len() as u16).to_be_bytes(), &[0; 4]].concat();
            [upgrade("/"), head, text.into_bytes()].concat()
        }
    }
}

/// Opens connections to `ports`, of the viewer and of Foxglove, until `is_over`.
fn attack(ports: [u16; 2], is_over: &AtomicBool, attempts: &AtomicUsize) {
    // It is the node that is tried: what attackers take of this machine is not to be counted.
    let _ = rustix::process::nice(19);
    let begin = Instant::now();
    let mut open: Vec<Option<TcpStream>> = (0..CONNECTIONS).map(|_| None).collect();
    for k in (0..CONNECTIONS).cycle().take_while(|_| !is_over.load(Ordering::Relaxed) && begin.elapsed() < LONGEST) {
        let kind = k % 4;
        let is_closed = |stream: &TcpStream| {
            let is_refused = |e: std::io::Error| e.kind() != std::io::ErrorKind::WouldBlock;
            stream.set_nonblocking(true).is_err() || (kind < 2 && (&*stream).read(&mut [0; 16]).map_or_else(is_refused, |count| count == 0))
        };
        if open[k].as_ref().is_none_or(is_closed) {
            open[k] = TcpStream::connect(("127.0.0.1", ports[usize::from(kind == 1 || kind == 3)])).ok();
            if let Some(stream) = &mut open[k] {
                let _ = stream.write_all(&request(kind));
            }
            attempts.fetch_add(1, Ordering::Relaxed);
        }
        std::thread::sleep(PAUSE);
    }
}

/// A node whose viewer and Foxglove's port are open.
struct Node {
    child: Child,
    lines: Box<dyn Iterator<Item = String> + Send>,
    said: Vec<String>,
}

impl Node {
    /// The node of a sensor serves when that is heard: the ports are chosen before.
    fn start(dir: &Path, arguments: &str) -> (Self, [u16; 2]) {
        let ports = [(); 2].map(|()| TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port());
        let [view, foxglove] = ports;
        let arguments = format!("live {arguments} --view=127.0.0.1:{view} --foxglove=127.0.0.1:{foxglove} --json");
        let mut child = voxelastic(dir).args(arguments.split(' ')).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let lines = Box::new(BufReader::new(child.stderr.take().unwrap()).lines().map_while(Result::ok));
        (Self { child, lines, said: Vec::new() }, ports)
    }

    fn next(&mut self) -> String {
        let line = self.lines.next().unwrap_or_else(|| panic!("the node has ended: {:#?}", self.said));
        self.said.push(line.clone());
        line
    }

    /// The most memory that it has had, megabytes.
    fn peak_mb(&self) -> f64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:")?.split_whitespace().next()?.parse::<f64>().ok());
        peak.unwrap() / 1024.0
    }

    /// Ends it; what it says of the run.
    fn end(self) -> serde_json::Value {
        kill_process(Pid::from_child(&self.child), Signal::INT).unwrap();
        let rest = std::thread::spawn(move || self.lines.for_each(drop));
        let done: Finished = self.child.wait_with_output().unwrap().into();
        rest.join().unwrap();
        assert!(matches!(done.code, Some(0 | 130)), "{:?}: {:#?}", done.code, self.said);
        serde_json::from_str(&done.out).unwrap()
    }
}

/// What a run has come to.
#[derive(Debug)]
struct Came {
    scans: u64,
    lost: u64,
    seconds: f64,
    peak_mb: f64,
    attempts: usize,
}

/// Maps, with attackers or without, while `feed` sends what comes by itself and returns when it has.
fn mapped(dir: &Path, arguments: &str, is_attacked: bool, feed: impl FnOnce(&mut Node)) -> Came {
    let (mut node, ports) = Node::start(dir, arguments);
    let (is_over, attempts) = (AtomicBool::new(false), AtomicUsize::new(0));
    let (seconds, peak_mb) = std::thread::scope(|scope| {
        for _ in 0..if is_attacked { ATTACKERS } else { 0 } {
            scope.spawn(|| attack(ports, &is_over, &attempts));
        }
        let begin = Instant::now();
        feed(&mut node);
        let seconds = begin.elapsed().as_secs_f64();
        let peak = node.peak_mb();
        is_over.store(true, Ordering::Relaxed);
        (seconds, peak)
    });
    let done = node.end();
    let number = |key: &str| done[key].as_u64().unwrap_or(0);
    let lost = number("scans_came") - number("scans") + number("scans_skipped") + number("scans_left_out");
    Came { scans: number("scans"), lost, seconds, peak_mb, attempts: attempts.into_inner() }
}

/// A recording that is played as fast as it can be mapped, until all of it is.
fn recording(dir: &Path, is_attacked: bool) -> Came {
    let hall = voxelastic_testing::data_folder().join("hall");
    let arguments = format!("--from {} --rate max -o hall.vox --overwrite --restart --voxel-size 0.05 --threads 1", hall.display());
    mapped(dir, &arguments, is_attacked, |node| while !node.next().contains(" scans mapped") {})
}

/// A sensor's packets; others send packets of another sensor, and of another place, at as many a second.
fn sensor(dir: &Path, is_attacked: bool) -> Came {
    let port = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let turns: Vec<_> = packets::velodyne(0.0, TURNS, |beam| (4.0 + (beam.azimuth.to_radians() * 2.0).sin() + 0.02 * beam.elevation, 50));
    let strange: Vec<_> = packets::velodyne(0.0, 3.0, |_| (9.0, 9)).into_iter().chain(packets::hesai(0.0, 3.0, |_| (9.0, 9))).collect();
    mapped(dir, &format!("--lidar {port} -o sensor.vox --overwrite --restart --every scan --voxel-size 0.1 --threads 1"), is_attacked, |_| {
        let is_over = AtomicBool::new(false);
        std::thread::scope(|scope| {
            for address in ["127.0.0.2:0", "127.0.0.3:0"].iter().take(if is_attacked { 2 } else { 0 }) {
                let (strange, is_over) = (&strange, &is_over);
                scope.spawn(move || {
                    let _ = rustix::process::nice(19);
                    let socket = UdpSocket::bind(address).unwrap();
                    for (_, packet) in strange.iter().cycle().take_while(|_| !is_over.load(Ordering::Relaxed)) {
                        let _ = socket.send_to(packet, ("127.0.0.1", port));
                        std::thread::sleep(Duration::from_millis(2));
                    }
                });
            }
            let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
            let begin = Instant::now();
            for (time, packet) in &turns {
                std::thread::sleep(Duration::from_secs_f64(*time).saturating_sub(begin.elapsed()));
                socket.send_to(packet, ("127.0.0.1", port)).unwrap();
            }
            is_over.store(true, Ordering::Relaxed);
        });
        std::thread::sleep(Duration::from_secs(1));
    })
}

/// The smallest time and peak of some runs, in which nothing was lost.
fn best(runs: &[Came]) -> (f64, f64) {
    (runs.iter().map(|came| came.seconds).fold(f64::INFINITY, f64::min), runs.iter().map(|came| came.peak_mb).fold(f64::INFINITY, f64::min))
}

#[test]
#[ignore = "minutes, and figures of a machine that is idle otherwise: the command is in the book's chapter on reliability"]
fn all_attacks_at_once_cost_no_scan() {
    let temporary = tempfile::tempdir().unwrap();
    let dir = temporary.path();
    let mut ratios = Vec::new();
    for (name, run) in [("sensor", sensor as fn(&Path, bool) -> Came), ("hall", recording)] {
        let (mut alone, mut attacked) = (Vec::new(), Vec::new());
        for _ in 0..3 {
            alone.push(run(dir, false));
            attacked.push(run(dir, true));
            println!("{name}: alone {:?}\n      attacked {:?}", alone.last().unwrap(), attacked.last().unwrap());
        }
        let ((seconds, peak), (attacked_seconds, attacked_peak)) = (best(&alone), best(&attacked));
        println!("{name}: {:.2} x the time, {:.0} MB more", attacked_seconds / seconds, attacked_peak - peak);
        assert!(attacked.iter().chain(&alone).all(|came| came.lost == 0 && came.scans == alone[0].scans));
        assert!(attacked.iter().all(|came| came.attempts > CONNECTIONS));
        // Foxglove's port keeps a number of megabytes for its clients, however many there are.
        assert!(attacked_peak < peak + 200.0);
        ratios.push(attacked_seconds / seconds);
    }
    assert!(ratios.iter().all(|ratio| *ratio < 1.15), "{ratios:?}");
}
