//! Messages of topics in MCAP files. They are those of ROS 2, with their definitions.

use super::middleware::{MiddlewareError, Sink};
use mcap::records::MessageHeader;
use mcap::{WriteOptions, Writer};
use std::collections::BTreeMap;
use std::fmt::Display;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{SystemTime, UNIX_EPOCH};
use voxelastic_io::ros::definition;

/// Messages that may wait to be written.
const WAITING: usize = 1024;

/// Writes messages into an MCAP file, on a thread of its own.
pub struct Recorder {
    path: PathBuf,
    writer: Arc<Mutex<Writer<BufWriter<File>>>>,
    messages: SyncSender<Option<Record>>,
    lost: Arc<AtomicUsize>,
    thread: Option<JoinHandle<Result<(), mcap::McapError>>>,
}

/// A channel, when a message came, nanoseconds, and the message.
type Record = (u16, u64, Vec<u8>);

impl Recorder {
    /// Begins a file, which must not exist.
    ///
    /// # Errors
    /// When it exists or cannot be written.
    pub fn create(path: &Path) -> Result<Self, MiddlewareError> {
        let failed = |problem: &dyn Display| MiddlewareError::new(format!("cannot record to {}", path.display()), problem);
        let file = File::create_new(path).map_err(|e| failed(&e))?;
        let writer = WriteOptions::new().profile("ros2").create(BufWriter::new(file)).map_err(|e| failed(&e))?;
        let writer = Arc::new(Mutex::new(writer));
        let (messages, records) = sync_channel::<Option<Record>>(WAITING);
        let ours = Arc::clone(&writer);
        let write = move || {
            while let Ok(Some((channel_id, time, message))) = records.recv() {
                let header = MessageHeader { channel_id, sequence: 0, log_time: time, publish_time: time };
                lock(&ours).write_to_known_channel(&header, &message)?;
            }
            lock(&ours).finish().map(drop)
        };
        let thread = std::thread::Builder::new().name("recorder".to_owned()).spawn(write).map_err(|e| failed(&e))?;
        Ok(Self { path: path.to_owned(), writer, messages, lost: Arc::default(), thread: Some(thread) })
    }

    /// Begins a topic.
    ///
    /// # Errors
    /// When its type is not known.
    pub fn topic(&self, name: &str, kind: &str) -> Result<RecordedTopic, MiddlewareError> {
        let failed = |problem: &dyn Display| MiddlewareError::new(format!("cannot record {name}"), problem);
        let definition = definition(kind).ok_or_else(|| failed(&format!("{kind} is not known")))?;
        let mut writer = lock(&self.writer);
        let schema = writer.add_schema(kind, "ros2msg", definition.as_bytes()).map_err(|e| failed(&e))?;
        let channel = writer.add_channel(schema, name, "cdr", &BTreeMap::new()).map_err(|e| failed(&e))?;
        Ok(RecordedTopic { channel, messages: self.messages.clone(), lost: Arc::clone(&self.lost) })
    }

    /// Messages that could not be written, because the disk was too slow or refused.
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
        let Some(thread) = self.thread.take() else { return Ok(()) };
        let _ = self.messages.send(None);
        let written = thread.join().unwrap_or(Ok(()));
        written.map_err(|e| MiddlewareError::new(format!("the recording {} is not complete", self.path.display()), e))
    }
}

fn lock<T>(writer: &Mutex<T>) -> MutexGuard<'_, T> {
    writer.lock().unwrap_or_else(PoisonError::into_inner)
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
    channel: u16,
    messages: SyncSender<Option<Record>>,
    lost: Arc<AtomicUsize>,
}

impl RecordedTopic {
    /// Records a message that came now.
    pub fn record(&self, message: &[u8]) {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as u64);
        // A recorder that is closed takes nothing: nothing is lost then.
        if let Err(TrySendError::Full(_)) = self.messages.try_send(Some((self.channel, now, message.to_vec()))) {
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

    fn is_remote(&self) -> bool {
        false
    }
}
