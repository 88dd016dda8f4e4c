//! What comes on which topic: how many messages, and how long ago the last.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Counts of the messages of all topics that are subscribed to; shared with the threads that deliver them.
#[derive(Clone, Debug)]
pub struct Heard(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    start: Instant,
    topics: Vec<Topic>,
}

#[derive(Debug)]
struct Topic {
    name: String,
    is_steady: bool,
    count: AtomicU64,
    /// When the last message came, microseconds after the start.
    last_us: AtomicU64,
}

/// A topic, as it is now.
#[derive(Clone, Debug, PartialEq)]
pub struct HeardTopic {
    /// Its name.
    pub name: String,
    /// Whether messages should come all the time: not so on `/tf_static`, and for corrections.
    pub is_steady: bool,
    /// Messages that came.
    pub count: u64,
    /// How long ago the last one came; before the first, how long it is waited for.
    pub age: Duration,
}

impl Heard {
    /// Of topics by their names, each with whether messages should come all the time.
    pub fn new(topics: impl IntoIterator<Item = (String, bool)>) -> Self {
        let topic = |(name, is_steady)| Topic { name, is_steady, count: AtomicU64::new(0), last_us: AtomicU64::new(0) };
        Self(Arc::new(Inner { start: Instant::now(), topics: topics.into_iter().map(topic).collect() }))
    }

    /// A message came on the topic with this position.
    pub fn note(&self, topic: usize) {
        let Some(topic) = self.0.topics.get(topic) else { return };
        topic.count.fetch_add(1, Ordering::Relaxed);
        topic.last_us.store(self.0.start.elapsed().as_micros() as u64, Ordering::Relaxed);
    }

    /// All topics.
    pub fn topics(&self) -> Vec<HeardTopic> {
        let now = self.0.start.elapsed();
        let topic = |topic: &Topic| HeardTopic {
            name: topic.name.clone(),
            is_steady: topic.is_steady,
            count: topic.count.load(Ordering::Relaxed),
            age: now.saturating_sub(Duration::from_micros(topic.last_us.load(Ordering::Relaxed))),
        };
        self.0.topics.iter().map(topic).collect()
    }
}
