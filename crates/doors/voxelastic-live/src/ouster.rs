//! An Ouster sensor as a transport: its UDP packets, without a driver.

use crate::transport::Transport;
use crate::udp::{Listener, next_scan};
use std::io::{self, Read, Write};
use std::net::{IpAddr, SocketAddr, TcpStream, ToSocketAddrs};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicUsize;
use std::sync::mpsc::sync_channel;
use std::time::{Duration, Instant};
use voxelastic_io::bag::live::LiveScans;
use voxelastic_io::ouster::SensorMetadata;
use voxelastic_run::{Error, Input, Result};

/// Datagrams that may wait to be looked at: more than a second of the largest sensor.
const WAITING: usize = 16_384;
/// A sensor has answered within this time, and with no more than this many bytes.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(10);
const LARGEST_ANSWER: usize = 16 << 20;

/// Asks a sensor for its description, over HTTP: `/api/v1/sensor/metadata` (firmware 2.1 and later). `host` is a name or an address, perhaps with a port.
///
/// # Errors
/// When nothing answers there, or not what a sensor does.
pub fn ask_metadata(host: &str) -> io::Result<Vec<u8>> {
    let address = if host.rsplit_once(':').is_some_and(|(_, port)| port.parse::<u16>().is_ok()) { host.to_owned() } else { format!("{host}:80") };
    let address = address.to_socket_addrs()?.next().ok_or_else(|| io::Error::new(io::ErrorKind::NotFound, "the name has no address"))?;
    let mut stream = TcpStream::connect_timeout(&address, ANSWER_TIMEOUT)?;
    let deadline = Instant::now() + ANSWER_TIMEOUT;
    stream.set_write_timeout(Some(ANSWER_TIMEOUT))?;
    // Version 1.0: the answer comes in one piece, and ends with the connection.
    stream.write_all(format!("GET /api/v1/sensor/metadata HTTP/1.0\r\nHost: {host}\r\n\r\n").as_bytes())?;
    let wrong = |what: String| io::Error::new(io::ErrorKind::InvalidData, what);
    let (mut answer, mut part) = (Vec::new(), vec![0; 1 << 16]);
    loop {
        let left = deadline.saturating_duration_since(Instant::now());
        if left.is_zero() || answer.len() > LARGEST_ANSWER {
            return Err(wrong("its answer does not end".into()));
        }
        stream.set_read_timeout(Some(left))?;
        match stream.read(&mut part)? {
            0 => break,
            length => answer.extend(&part[..length]),
        }
    }
    let head = answer.windows(4).position(|bytes| bytes == b"\r\n\r\n").ok_or_else(|| wrong("it does not answer like an HTTP server".into()))?;
    let body = answer.split_off(head + 4);
    let status = String::from_utf8_lossy(&answer).lines().next().unwrap_or_default().to_owned();
    if status.split(' ').nth(1) == Some("200") { Ok(body) } else { Err(wrong(format!("it answers: {status}"))) }
}

/// A sensor whose packets come to this machine.
pub struct OusterInput {
    scans: LiveScans,
    sockets: Vec<Listener>,
    lost: Arc<AtomicUsize>,
}

impl OusterInput {
    /// Listens at `addresses` for packets of a sensor; those of the lidar and of the inertial measurement unit may come to the same port. With `from`, packets
    /// of other machines are ignored; without, those of others than the first with several that belong together, until that one is silent.
    ///
    /// # Errors
    /// When a port is taken.
    pub fn listen(metadata: SensorMetadata, addresses: &[SocketAddr], from: Option<IpAddr>, use_imu: bool) -> io::Result<Self> {
        let (sender, packets) = sync_channel(WAITING);
        let lost = Arc::<AtomicUsize>::default();
        let listen = |address: &SocketAddr| Listener::start(*address, from, sender.clone(), Arc::clone(&lost));
        let sockets = addresses.iter().map(listen).collect::<io::Result<Vec<_>>>()?;
        Ok(Self { scans: LiveScans::of_ouster(metadata, packets, "the sensor", use_imu), sockets, lost })
    }

    /// Where it listens.
    pub fn addresses(&self) -> Vec<SocketAddr> {
        self.sockets.iter().map(Listener::address).collect()
    }

    /// Counts of datagrams that came and were not looked at.
    pub fn lost(&self) -> Arc<AtomicUsize> {
        Arc::clone(&self.lost)
    }
}

impl Transport for OusterInput {
    fn next(&mut self, is_stopped: &dyn Fn() -> bool) -> Option<Input> {
        let next = next_scan(&mut self.scans, is_stopped);
        if next.is_none() {
            self.sockets.clear();
        }
        next
    }
}

/// The port to which sensors send the packets of the lidar, unless they are told otherwise.
pub const LIDAR_PORT: u16 = 7502;

/// A sensor's name or address, or a port of this machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum OusterAddress {
    /// A sensor, which is asked what it is; only its packets are taken.
    Sensor(String),
    /// A port to which somebody sends packets.
    Port(u16),
}

impl OusterAddress {
    /// Parses the argument.
    pub fn parse(text: &str) -> Result<Self, String> {
        match text.parse() {
            Ok(port) if port > 0 => Ok(Self::Port(port)),
            Ok(_) => Err("a port is 1 to 65535".to_owned()),
            Err(_) if text.is_empty() || text.contains(char::is_whitespace) => Err("must be a sensor's name or address, or a port".to_owned()),
            Err(_) => Ok(Self::Sensor(text.to_owned())),
        }
    }

    /// The port, if it was given.
    pub fn port(&self) -> Option<u16> {
        if let Self::Port(port) = self { Some(*port) } else { None }
    }

    /// The address of the sensor, if it is known.
    pub fn host(&self) -> Option<IpAddr> {
        let Self::Sensor(host) = self else { return None };
        let name = host.rsplit_once(':').filter(|(_, port)| port.parse::<u16>().is_ok()).map_or(host.as_str(), |(name, _)| name);
        (name, 0).to_socket_addrs().ok()?.next().map(|address| address.ip())
    }

    /// What the sensor is: from a file, else it is asked.
    pub fn metadata(&self, file: Option<&Path>) -> Result<SensorMetadata> {
        match (file, self) {
            (Some(file), _) => Ok(SensorMetadata::read(file)?),
            (None, Self::Sensor(host)) => {
                let remedy = "check its address; or save its description as a file, and name it with --metadata";
                let answer =
                    ask_metadata(host).map_err(|problem| Error::new(format!("{host}: the sensor cannot be asked what it is: {problem}"), remedy))?;
                Ok(SensorMetadata::parse(&answer, Path::new(host))?)
            }
            (None, Self::Port(port)) => {
                let remedy = "name the sensor's description with --metadata, or give the sensor's address instead of a port";
                Err(Error::usage(format!("--ouster {port} does not say what sensor it is"), remedy))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::TcpListener;

    #[test]
    fn a_sensor_is_asked_for_its_description() {
        let server = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = server.local_addr().unwrap().to_string();
        let endless = "x".repeat(LARGEST_ANSWER + 1);
        let answers = ["HTTP/1.1 200 OK\r\nContent-Type: application/json\r\n\r\n{\"a\":1}", "HTTP/1.1 404 Not Found\r\n\r\nno", "garbage", &endless]
            .map(str::to_owned);
        let thread = std::thread::spawn(move || {
            for answer in answers {
                let (mut stream, _) = server.accept().unwrap();
                let mut request = [0; 200];
                let length = stream.read(&mut request).unwrap();
                assert!(request[..length].starts_with(b"GET /api/v1/sensor/metadata HTTP/1.0\r\nHost: 127.0.0.1"));
                // Who has had enough of it closes.
                let _ = stream.write_all(answer.as_bytes());
            }
        });
        assert_eq!(ask_metadata(&address).unwrap(), b"{\"a\":1}");
        assert!(ask_metadata(&address).unwrap_err().to_string().contains("404"));
        assert!(ask_metadata(&address).unwrap_err().to_string().contains("HTTP"));
        assert!(ask_metadata(&address).unwrap_err().to_string().contains("does not end"));
        thread.join().unwrap();
        assert!(ask_metadata(&address).is_err());
    }

    #[test]
    fn sensors_and_ports_are_told_apart() {
        let sensor = |text: &str| Ok(OusterAddress::Sensor(text.to_owned()));
        assert_eq!(OusterAddress::parse("7502"), Ok(OusterAddress::Port(7502)));
        assert_eq!(OusterAddress::parse("os-122.local"), sensor("os-122.local"));
        assert!(["", "0", "a b"].iter().all(|text| OusterAddress::parse(text).is_err()));
        assert_eq!(OusterAddress::parse("127.0.0.1:8080").unwrap().host(), Some(IpAddr::from([127, 0, 0, 1])));
        assert_eq!(OusterAddress::Port(1).host(), None);
    }
}
