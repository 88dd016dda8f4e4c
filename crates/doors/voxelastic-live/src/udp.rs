//! Datagrams of a sensor: sockets and the threads that wait at them.

use std::io;
use std::net::{IpAddr, SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{SyncSender, TrySendError};
use std::thread::JoinHandle;
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use voxelastic_io::bag::live::{LiveScans, Polled, SensorPacket};
use voxelastic_run::Input;
use voxelastic_slam::slam::RawScan;

/// The largest datagram.
const LARGEST: usize = 1 << 16;
/// Others whose datagrams are ignored are spoken of, up to so many.
const SPOKEN_OF: usize = 8;
/// How often a thread that waits for datagrams looks whether to end.
const LOOK: Duration = Duration::from_millis(50);

/// A socket and the thread that waits for its datagrams; both end when it is dropped.
pub(crate) struct Listener {
    address: SocketAddr,
    is_over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Listener {
    /// Sends each datagram on, with `from` those of this machine only. What there is no room for is counted as lost.
    pub(crate) fn start(address: SocketAddr, from: Option<IpAddr>, sender: SyncSender<SensorPacket>, lost: Arc<AtomicUsize>) -> io::Result<Self> {
        let socket = UdpSocket::bind(address)?;
        socket.set_read_timeout(Some(LOOK))?;
        let (address, is_over) = (socket.local_addr()?, Arc::<AtomicBool>::default());
        let over = Arc::clone(&is_over);
        let task = move || {
            let (mut buffer, mut others) = (vec![0; LARGEST], Vec::new());
            while !over.load(Ordering::Relaxed) {
                let Ok((length, source)) = socket.recv_from(&mut buffer) else { continue };
                if let Some(from) = from.filter(|from| source.ip() != *from) {
                    if others.len() < SPOKEN_OF && !others.contains(&source.ip()) {
                        tracing::warn!("packets from {} are ignored: only those of {from} are taken", source.ip());
                        others.push(source.ip());
                    }
                    continue;
                }
                let time = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64());
                let packet = SensorPacket { payload: buffer[..length].to_vec(), source: source.ip(), time };
                if let Err(TrySendError::Full(_)) = sender.try_send(packet) {
                    lost.fetch_add(1, Ordering::Relaxed);
                }
            }
        };
        let thread = std::thread::Builder::new().name("sensor".to_owned()).spawn(task)?;
        Ok(Self { address, is_over, thread: Some(thread) })
    }

    /// Where it listens.
    pub(crate) fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// The next scan, or what cannot be used; none once it is stopped or has ended.
pub(crate) fn next_scan(scans: &mut LiveScans, is_stopped: &dyn Fn() -> bool) -> Option<Input> {
    while !is_stopped() {
        match scans.poll() {
            Polled::Item(Ok(scan)) => {
                return Some(Input::RawScan(RawScan { node: scan.node, time: scan.time, cloud: scan.cloud, imu: scan.imu }, scan.name));
            }
            Polled::Item(Err(error)) => return Some(Input::from(error)),
            Polled::Nothing => {}
            Polled::End => break,
        }
    }
    None
}
