//! Files of messages, whatever their format.

use crate::Result;
pub(crate) use crate::ros::Encoding;

/// A topic of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Topic {
    /// Such as `/points_raw`.
    pub(crate) name: String,
    /// Message type as package/Type, without ROS 2's `/msg/`.
    pub(crate) kind: String,
    pub(crate) encoding: Encoding,
}

impl Topic {
    pub(crate) fn new(name: String, kind: &str, encoding: Encoding) -> Self {
        Self { name, kind: kind.replace("/msg/", "/"), encoding }
    }
}

/// A serialised message.
#[derive(Debug)]
pub(crate) struct Message {
    /// Index of its topic in [`Container::topics`].
    pub(crate) topic: usize,
    /// When it was recorded, nanoseconds.
    pub(crate) time_ns: i64,
    /// Its offset in the file (that of its chunk, if it is in one); the number of its row in a database.
    pub(crate) at: u64,
    pub(crate) data: Vec<u8>,
}

impl Message {
    /// When it was recorded, seconds.
    pub(crate) fn time(&self) -> f64 {
        self.time_ns as f64 * 1e-9
    }
}

/// What a file's index says, without reading its messages.
#[derive(Clone, Debug, Default)]
pub(crate) struct Index {
    /// Number of messages of each topic, in the order of the topics.
    pub(crate) counts: Vec<u64>,
    /// Times of the first and the last message, nanoseconds.
    pub(crate) times_ns: Option<(i64, i64)>,
}

/// A file of messages.
pub(crate) trait Container: Send {
    /// The topics known so far; more may appear while messages are read.
    fn topics(&self) -> &[Topic];

    /// The file's index, if it has one and it is intact.
    fn index(&self) -> Option<Index>;

    /// The next message of a wanted topic, in the order of the file. An error names a part that cannot be read; the next call continues
    /// after it, as far as that is possible.
    fn next(&mut self, wanted: &dyn Fn(&Topic) -> bool) -> Option<Result<Message>>;
}
