//! A link of limited rate between a robot and those who listen, such as a radio: what goes out is counted, and what is less urgent waits.
//!
//! What is sent is owed until the link has carried it. Nothing but what is small and urgent is sent while something is owed, so that on average no more goes out than the link carries; what
//! is large and not urgent, such as the surface, goes out only while the link has little to do, so that it keeps nothing else waiting for long.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// How urgent a message is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Urgency {
    /// Small, and robots and those who watch them live by it: transforms, how the node is. It is sent at once.
    AtOnce,
    /// What planners need.
    Soon,
    /// What people look at.
    Later,
}

/// A link, shared by all that send over it.
#[derive(Debug)]
pub struct Link {
    /// Bytes per second.
    rate: f64,
    state: Mutex<State>,
}

#[derive(Clone, Copy, Debug)]
struct State {
    /// Bytes that are owed, as of a time.
    owed: f64,
    at: Instant,
    /// Bytes that were sent in all.
    sent: u64,
}

impl State {
    fn until(&mut self, now: Instant, rate: f64) -> f64 {
        self.owed = (self.owed - rate * now.saturating_duration_since(self.at).as_secs_f64()).max(0.0);
        self.at = now;
        self.owed
    }
}

impl Link {
    /// One that carries `rate` bytes per second.
    pub fn new(rate: f64) -> Self {
        Self { rate, state: Mutex::new(State { owed: 0.0, at: Instant::now(), sent: 0 }) }
    }

    /// Bytes that it carries in so many seconds.
    pub fn carries(&self, seconds: f64) -> usize {
        (self.rate * seconds) as usize
    }

    /// Whether a message may be sent now.
    pub fn may_send(&self, urgency: Urgency) -> bool {
        self.wait(urgency, Instant::now()).is_zero()
    }

    /// How long a message has to wait, if nothing else is sent meanwhile.
    pub fn wait(&self, urgency: Urgency, now: Instant) -> Duration {
        let owed = self.state.lock().unwrap_or_else(PoisonError::into_inner).until(now, self.rate);
        let most = match urgency {
            Urgency::AtOnce => return Duration::ZERO,
            // What is owed for tiles of the surface does not keep it waiting.
            Urgency::Soon => 0.5 * self.rate,
            Urgency::Later => 0.0,
        };
        Duration::from_secs_f64((owed - most).max(0.0) / self.rate)
    }

    /// A message is sent, to so many.
    pub fn send(&self, bytes: usize, receivers: usize) {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        state.until(Instant::now(), self.rate);
        state.owed += (bytes * receivers) as f64;
        state.sent += (bytes * receivers) as u64;
    }

    /// Bytes that were sent in all.
    pub fn sent(&self) -> u64 {
        self.state.lock().unwrap_or_else(PoisonError::into_inner).sent
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_sent_is_owed_until_it_was_carried() {
        let link = Link::new(1000.0);
        let begin = Instant::now();
        assert!(link.may_send(Urgency::Later));
        link.send(700, 2);
        let wait = |urgency, s: f64| link.wait(urgency, begin + Duration::from_secs_f64(s)).as_secs_f64();
        assert_eq!(wait(Urgency::AtOnce, 0.1), 0.0);
        // 1,400 bytes take 1.4 s; who plans sends once half a second of them is left.
        let near = |a: f64, b: f64| (a - b).abs() < 0.05;
        assert!(near(wait(Urgency::Soon, 0.1), 0.8) && near(wait(Urgency::Later, 0.2), 1.2));
        assert_eq!((wait(Urgency::Soon, 1.0), wait(Urgency::Later, 1.5), link.sent()), (0.0, 0.0, 1400));
        // What was not used is not saved for later.
        assert_eq!(wait(Urgency::Later, 100.0), 0.0);
    }
}
