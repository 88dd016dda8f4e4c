//! Messages that wait for a slow network on a thread of their own, so that nobody else does.

use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// How long a topic that ends waits until its last messages are sent.
const LAST_WAIT: Duration = Duration::from_secs(6);

/// Sends a message; it may wait for the network.
pub type SendTask = Box<dyn FnOnce() + Send>;

/// A thread that sends messages in their order.
pub struct Outbox {
    shared: Arc<Shared>,
}

impl Outbox {
    /// Starts the thread.
    ///
    /// # Errors
    /// When the system has none to give.
    pub fn start(thread: &str) -> io::Result<Self> {
        let shared = Arc::<Shared>::default();
        let ours = Arc::clone(&shared);
        std::thread::Builder::new().name(thread.to_owned()).spawn(move || ours.run())?;
        Ok(Self { shared })
    }

    /// A topic of which at most `depth` messages wait.
    pub fn topic(&self, depth: usize) -> OutboxTopic {
        let mut state = self.shared.lock();
        state.topics += 1;
        OutboxTopic { shared: Arc::clone(&self.shared), number: state.topics, depth: depth.max(1) }
    }
}

impl Drop for Outbox {
    fn drop(&mut self) {
        self.shared.lock().has_ended = true;
        self.shared.changed.notify_all();
    }
}

/// The messages of one topic. Dropping it waits a few seconds until they are sent.
pub struct OutboxTopic {
    shared: Arc<Shared>,
    number: usize,
    depth: usize,
}

impl OutboxTopic {
    /// Hands over a message; false if the oldest one that waited is lost for it, because there were too many.
    pub fn push(&self, send: SendTask) -> bool {
        let mut state = self.shared.lock();
        let is_full = state.waiting(self.number) >= self.depth;
        if is_full {
            let oldest = state.messages.iter().position(|(topic, _)| *topic == self.number);
            oldest.map(|k| state.messages.remove(k));
        }
        state.messages.push_back((self.number, send));
        self.shared.changed.notify_all();
        !is_full
    }

    /// How many messages wait; the one that is being sent does not.
    pub fn waiting(&self) -> usize {
        self.shared.lock().waiting(self.number)
    }
}

impl Drop for OutboxTopic {
    fn drop(&mut self) {
        let is_pending = |state: &mut State| !state.has_ended && (state.sending == self.number || state.waiting(self.number) > 0);
        let state = self.shared.lock();
        drop(self.shared.changed.wait_timeout_while(state, LAST_WAIT, is_pending).unwrap_or_else(PoisonError::into_inner));
    }
}

#[derive(Default)]
struct Shared {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    messages: VecDeque<(usize, SendTask)>,
    /// The topic of the message that is being sent; topics are counted from one.
    sending: usize,
    topics: usize,
    has_ended: bool,
}

impl State {
    fn waiting(&self, number: usize) -> usize {
        self.messages.iter().filter(|(topic, _)| *topic == number).count()
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn run(&self) {
        loop {
            let idle = |state: &mut State| state.messages.is_empty() && !state.has_ended;
            let mut state = self.changed.wait_while(self.lock(), idle).unwrap_or_else(PoisonError::into_inner);
            let Some((topic, send)) = state.messages.pop_front() else { return };
            state.sending = topic;
            drop(state);
            send();
            self.lock().sending = 0;
            self.changed.notify_all();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::{Receiver, channel};

    /// A message that is sent when the gate opens, and then says its name.
    fn message(gate: &Arc<Mutex<Receiver<()>>>, sent: &Arc<Mutex<Vec<String>>>, name: &str) -> SendTask {
        let (gate, sent, name) = (Arc::clone(gate), Arc::clone(sent), name.to_owned());
        Box::new(move || {
            gate.lock().unwrap().recv().ok();
            sent.lock().unwrap().push(name);
        })
    }

    #[test]
    fn a_network_that_is_stuck_holds_nobody_up_and_the_newest_messages_are_kept() {
        let (open, gate) = channel();
        let (gate, sent) = (Arc::new(Mutex::new(gate)), Arc::default());
        let outbox = Outbox::start("test").unwrap();
        let (tiles, path) = (outbox.topic(3), outbox.topic(1));
        let push = |topic: &OutboxTopic, name: &str| topic.push(message(&gate, &sent, name));
        assert!(push(&tiles, "tile 0"));
        while tiles.waiting() > 0 {
            std::thread::yield_now();
        }
        // The first is being sent, and stuck.
        assert!(push(&path, "path 0") && push(&tiles, "tile 1") && push(&tiles, "tile 2") && push(&tiles, "tile 3"));
        assert!(!push(&path, "path 1") && !push(&tiles, "tile 4"), "the oldest are lost");
        assert_eq!((tiles.waiting(), path.waiting()), (3, 1));
        assert!(sent.lock().unwrap().is_empty());
        (0..5).for_each(|_| open.send(()).unwrap());
        drop((tiles, path));
        assert_eq!(*sent.lock().unwrap(), ["tile 0", "tile 2", "tile 3", "path 1", "tile 4"], "a topic that ends waits for what it has to send");
    }
}
