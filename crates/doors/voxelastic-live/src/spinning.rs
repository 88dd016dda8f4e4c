//! A sensor that turns, Velodyne's, Hesai's or RoboSense's, as a transport: its UDP packets, without a driver.

use crate::transport::Transport;
use crate::udp::{Listener, next_scan};
use std::io;
use std::net::{IpAddr, SocketAddr, ToSocketAddrs};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicUsize;
use std::sync::mpsc::sync_channel;
use voxelastic_io::bag::live::LiveScans;
use voxelastic_run::{Error, Input, Result};

/// Datagrams that may wait to be looked at: more than a second of the sensors with the most.
const WAITING: usize = 16_384;

/// A sensor whose packets come to this machine. Some packets that belong together say which it is.
pub struct SpinningInput {
    scans: LiveScans,
    socket: Option<Listener>,
    address: SocketAddr,
    lost: Arc<AtomicUsize>,
}

impl SpinningInput {
    /// Listens at `address` for packets of a sensor. With `from`, packets of other machines are ignored; without, those of others than the sensor that was
    /// recognised, until it is silent. `angles` is a table of the angles of a Hesai or a RoboSense.
    ///
    /// # Errors
    /// When the port is taken.
    pub fn listen(address: SocketAddr, from: Option<IpAddr>, angles: Option<PathBuf>) -> io::Result<Self> {
        let (sender, packets) = sync_channel(WAITING);
        let lost = Arc::<AtomicUsize>::default();
        let socket = Listener::start(address, from, sender, Arc::clone(&lost))?;
        let address = socket.address();
        Ok(Self { scans: LiveScans::of_spinning(packets, "the sensor", angles), socket: Some(socket), address, lost })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Counts of datagrams that came and were not looked at.
    pub fn lost(&self) -> Arc<AtomicUsize> {
        Arc::clone(&self.lost)
    }
}

impl Transport for SpinningInput {
    fn next(&mut self, is_stopped: &dyn Fn() -> bool) -> Option<Input> {
        let next = next_scan(&mut self.scans, is_stopped);
        if next.is_none() {
            self.socket = None;
        }
        next
    }
}

/// The port to which Velodyne's and Hesai's sensors send their packets, unless they are told otherwise.
const PORT: u16 = 2368;

/// A sensor's name or address, if only its packets are to be taken, and the port of this machine that they come to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SpinningAddress {
    host: Option<String>,
    /// The port.
    pub port: u16,
}

impl SpinningAddress {
    /// Parses the argument: a port, a host, or both as HOST:PORT.
    pub fn parse(text: &str) -> Result<Self, String> {
        let port = |text: &str| text.parse().ok().filter(|port| *port > 0).ok_or_else(|| "a port is 1 to 65535".to_owned());
        if text.is_empty() || text.contains(char::is_whitespace) {
            return Err("must be a sensor's name or address, or a port".to_owned());
        }
        if text.bytes().all(|byte| byte.is_ascii_digit()) {
            return Ok(Self { host: None, port: port(text)? });
        }
        match text.rsplit_once(':') {
            Some((host, end)) if !host.is_empty() => Ok(Self { host: Some(host.to_owned()), port: port(end)? }),
            _ => Ok(Self { host: Some(text.to_owned()), port: PORT }),
        }
    }

    /// The address of the sensor, if only its packets are to be taken.
    pub fn host(&self) -> Result<Option<IpAddr>> {
        let Some(host) = &self.host else { return Ok(None) };
        // Sensors have no other.
        let found = (host.as_str(), 0).to_socket_addrs().ok().and_then(|mut all| all.find(|address| address.is_ipv4()));
        let unknown = || Error::new(format!("{host}: no machine has this name"), "give the sensor's address, or the port that it sends to");
        Ok(Some(found.ok_or_else(unknown)?.ip()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sensors_and_ports_are_told_apart() {
        let of = |host: Option<&str>, port| Ok(SpinningAddress { host: host.map(str::to_owned), port });
        assert_eq!(SpinningAddress::parse("2369"), of(None, 2369));
        assert_eq!(SpinningAddress::parse("192.168.1.201"), of(Some("192.168.1.201"), PORT));
        assert_eq!(SpinningAddress::parse("lidar.local:2369"), of(Some("lidar.local"), 2369));
        assert!(["", "0", "70000", "a b", "lidar:x", "lidar:0"].iter().all(|text| SpinningAddress::parse(text).is_err()));
        assert_eq!(SpinningAddress::parse("127.0.0.1").unwrap().host().unwrap(), Some(IpAddr::from([127, 0, 0, 1])));
    }
}
