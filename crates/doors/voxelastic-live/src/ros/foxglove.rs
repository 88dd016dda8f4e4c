//! Foxglove: what is published, over its WebSocket protocol and in MCAP files. The messages are those of ROS 2, with their definitions.

use super::middleware::{Delivery, MiddlewareError, Sink, TopicProfile};
use foxglove::websocket::{ChannelView, Client, ServerListener};
use foxglove::{Context, McapWriterHandle, PartialMetadata, RawChannel, Schema, WebSocketServerHandle};
use std::collections::HashMap;
use std::fmt::Display;
use std::fs::File;
use std::io::BufWriter;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{SystemTime, UNIX_EPOCH};
use voxelastic_io::ros::definition;

/// Messages that may wait to be written.
const WAITING: usize = 1024;
/// Messages that may wait for a client that reads slowly; then the oldest are dropped.
const BACKLOG: usize = 256;

fn channel(context: &Arc<Context>, name: &str, kind: &str) -> Result<Arc<RawChannel>, MiddlewareError> {
    let failed = |problem: &dyn Display| MiddlewareError::new(format!("cannot publish {name} for Foxglove"), problem);
    let definition = definition(kind).ok_or_else(|| failed(&format!("{kind} is not known")))?;
    let schema = Schema::new(kind, "ros2msg", definition.as_bytes());
    context.channel_builder(name).message_encoding("cdr").schema(schema).build_raw().map_err(|e| failed(&e))
}

/// A server for Foxglove. Clients can read, and change nothing.
pub struct FoxgloveServer {
    context: Arc<Context>,
    listeners: Arc<Listeners>,
    address: SocketAddr,
    server: Option<WebSocketServerHandle>,
}

/// Who listens to what, and what they get at once.
#[derive(Default)]
struct Listeners(Mutex<HashMap<String, Arc<Topic>>>);

/// A topic of the server.
struct Topic {
    channel: Arc<RawChannel>,
    subscribers: AtomicUsize,
    /// The last message, for those who come late, if it is a topic of that kind.
    last: Option<Mutex<Vec<u8>>>,
}

impl Listeners {
    fn topic(&self, name: &str) -> Option<Arc<Topic>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).get(name).cloned()
    }
}

impl ServerListener for Listeners {
    fn on_subscribe(&self, client: Client, channel: ChannelView<'_>) {
        let Some(topic) = self.topic(channel.topic()) else { return };
        topic.subscribers.fetch_add(1, Ordering::Relaxed);
        if let Some(last) = &topic.last {
            let last = last.lock().unwrap_or_else(PoisonError::into_inner).clone();
            if !last.is_empty() {
                topic.channel.log_to_sink(&last, client.sink_id());
            }
        }
    }

    fn on_unsubscribe(&self, _: Client, channel: ChannelView<'_>) {
        if let Some(topic) = self.topic(channel.topic()) {
            let _ = topic.subscribers.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |count| count.checked_sub(1));
        }
    }
}

impl FoxgloveServer {
    /// Serves at `address`; port 0 is one that is free.
    ///
    /// # Errors
    /// When the address is taken or not of this machine.
    pub fn start(name: &str, address: SocketAddr) -> Result<Self, MiddlewareError> {
        let (context, listeners) = (Context::new(), Arc::<Listeners>::default());
        let server = context.websocket_server().name(name).bind(address.ip().to_string(), address.port());
        let server = server.message_backlog_size(BACKLOG).listener(Arc::clone(&listeners) as Arc<dyn ServerListener>).start_blocking();
        let server = server.map_err(|e| MiddlewareError::new(format!("cannot serve Foxglove at {address}"), e))?;
        let address = SocketAddr::new(address.ip(), server.port());
        Ok(Self { context, listeners, address, server: Some(server) })
    }

    /// Where it is.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Announces a topic.
    ///
    /// # Errors
    /// When its type is not one of those that are published.
    pub fn advertise(&self, profile: &TopicProfile) -> Result<Box<dyn Sink>, MiddlewareError> {
        let channel = channel(&self.context, &profile.name, &profile.kind)?;
        let last = (profile.delivery == Delivery::Latched).then(Mutex::default);
        let topic = Arc::new(Topic { channel, subscribers: AtomicUsize::new(0), last });
        self.listeners.0.lock().unwrap_or_else(PoisonError::into_inner).insert(profile.name.clone(), Arc::clone(&topic));
        Ok(Box::new(ServerSink(topic)))
    }
}

impl Drop for FoxgloveServer {
    fn drop(&mut self) {
        if let Some(server) = self.server.take() {
            drop(server.stop());
        }
    }
}

struct ServerSink(Arc<Topic>);

impl Sink for ServerSink {
    fn publish(&mut self, message: &[u8]) -> Result<(), MiddlewareError> {
        if let Some(last) = &self.0.last {
            *last.lock().unwrap_or_else(PoisonError::into_inner) = message.to_vec();
        }
        self.0.channel.log(message);
        Ok(())
    }

    fn subscribers(&self) -> usize {
        self.0.subscribers.load(Ordering::Relaxed)
    }
}

/// Writes messages into an MCAP file, on a thread of its own.
pub struct Recorder {
    context: Arc<Context>,
    messages: SyncSender<Option<Record>>,
    lost: Arc<AtomicUsize>,
    thread: Option<JoinHandle<()>>,
    writer: Option<McapWriterHandle<BufWriter<File>>>,
}

/// A channel, when a message came, nanoseconds, and the message.
type Record = (Arc<RawChannel>, u64, Vec<u8>);

impl Recorder {
    /// Begins a file, which must not exist.
    ///
    /// # Errors
    /// When it exists or cannot be written.
    pub fn create(path: &Path) -> Result<Self, MiddlewareError> {
        let failed = |problem: &dyn Display| MiddlewareError::new(format!("cannot record to {}", path.display()), problem);
        let context = Context::new();
        let writer = context.mcap_writer().create_new_buffered_file(path).map_err(|e| failed(&e))?;
        let (messages, records) = sync_channel::<Option<Record>>(WAITING);
        let write = move || {
            while let Ok(Some((channel, time, message))) = records.recv() {
                channel.log_with_meta(&message, PartialMetadata { log_time: Some(time) });
            }
        };
        let thread = std::thread::Builder::new().name("recorder".to_owned()).spawn(write).map_err(|e| failed(&e))?;
        Ok(Self { context, messages, lost: Arc::default(), thread: Some(thread), writer: Some(writer) })
    }

    /// Begins a topic.
    ///
    /// # Errors
    /// When its type is not known.
    pub fn topic(&self, name: &str, kind: &str) -> Result<RecordedTopic, MiddlewareError> {
        let channel = channel(&self.context, name, kind)?;
        Ok(RecordedTopic { channel, messages: self.messages.clone(), lost: Arc::clone(&self.lost) })
    }

    /// Messages that could not be written, because the disk was too slow.
    pub fn lost(&self) -> usize {
        self.lost.load(Ordering::Relaxed)
    }

    /// Writes what waits, and completes the file.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn close(mut self) -> Result<(), MiddlewareError> {
        self.finish()
    }

    fn finish(&mut self) -> Result<(), MiddlewareError> {
        if let Some(thread) = self.thread.take() {
            let _ = self.messages.send(None);
            let _ = thread.join();
        }
        let closed = self.writer.take().map(McapWriterHandle::close).transpose();
        closed.map(drop).map_err(|e| MiddlewareError::new("the recording is not complete", e))
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        if let Err(problem) = self.finish() {
            tracing::warn!("{problem}");
        }
    }
}

/// A topic of a recording.
#[derive(Clone)]
pub struct RecordedTopic {
    channel: Arc<RawChannel>,
    messages: SyncSender<Option<Record>>,
    lost: Arc<AtomicUsize>,
}

impl RecordedTopic {
    /// Records a message that came now.
    pub fn record(&self, message: &[u8]) {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as u64);
        if let Err(TrySendError::Full(_)) = self.messages.try_send(Some((Arc::clone(&self.channel), now, message.to_vec()))) {
            self.lost.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl Sink for RecordedTopic {
    fn publish(&mut self, message: &[u8]) -> Result<(), MiddlewareError> {
        self.record(message);
        Ok(())
    }

    fn subscribers(&self) -> usize {
        1
    }
}
