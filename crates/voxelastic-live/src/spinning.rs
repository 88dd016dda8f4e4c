//! A sensor that turns, Velodyne's, Hesai's or RoboSense's, as a transport: its UDP packets, without a driver.

use crate::transport::Transport;
use crate::udp::{Listener, next_scan};
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicUsize;
use std::sync::mpsc::sync_channel;
use std::time::{SystemTime, UNIX_EPOCH};
use voxelastic_io::bag::live::{LiveScans, SensorPacket};
use voxelastic_run::Input;

/// Datagrams that may wait to be looked at: more than a second of the sensors with the most.
const WAITING: usize = 16_384;

/// A sensor whose packets come to this machine. The first packet that is recognised says which it is.
pub struct SpinningInput {
    scans: LiveScans,
    socket: Option<Listener>,
    address: SocketAddr,
    lost: Arc<AtomicUsize>,
}

impl SpinningInput {
    /// Listens at `address` for packets of a sensor. With `from`, packets of other machines are ignored; without, those of others than the first that is
    /// recognised. `angles` is a table of the angles of a Hesai or a RoboSense.
    ///
    /// # Errors
    /// When the port is taken.
    pub fn listen(address: SocketAddr, from: Option<IpAddr>, angles: Option<PathBuf>) -> io::Result<Self> {
        let (sender, packets) = sync_channel(WAITING);
        let lost = Arc::<AtomicUsize>::default();
        let now = || SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64());
        let received = move |payload, source| SensorPacket { payload, source, time: now() };
        let socket = Listener::start(address, from, sender, received, Arc::clone(&lost))?;
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
