//! The thread that a transport runs on, and the bounded queue between it and the mapper.

use crate::transport::Transport;
use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use voxelastic_run::Input;

/// Scans that may wait. At 10 Hz a pause of 0.4 s, as a correction of a large pose graph may take, leaves none out.
pub const WAITING_SCANS: usize = 4;
/// Scans that may wait as long as all of them came within 0.4 s: what comes at once after a moment in which nothing came is not too fast.
pub const WAITING_IN_BURST: usize = 16;
/// As long as four scans take at 10 Hz.
const BURST: Duration = Duration::from_millis(400);
/// Scans that may wait because of a [pause](Feed::begin_pause): a disk that others write to may keep a checkpoint waiting for seconds. Six at 10 Hz.
pub const WAITING_IN_PAUSE: usize = 64;
/// Other inputs that may wait; the transport waits when there are more.
const WAITING_OTHERS: usize = 1 << 16;
/// How often a thread that waits looks whether to stop.
const LOOK: Duration = Duration::from_millis(50);

/// What happens when scans come faster than they are taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Overload {
    /// The newest [`WAITING_SCANS`] wait, or [`WAITING_IN_BURST`], or [`WAITING_IN_PAUSE`]; the oldest one that waits is left out for each that comes. For sensors: they
    /// cannot wait. Edges and corrected poses are never left out.
    NewestWin,
    /// The transport waits, and no scan is left out. For recordings that are to be mapped whole.
    Wait,
}

/// Counts of a feed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FeedCounts {
    /// Scans that came.
    pub scans: usize,
    /// Scans that were left out, because newer ones came before they could be mapped.
    pub left_out: usize,
    /// Scans that wait.
    pub waiting: usize,
}

/// When an input came, and after what.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct Arrival {
    /// When it came.
    pub at: Instant,
    /// Inputs that the transport had given out with it, those left out among them.
    pub number: u64,
    /// Scans left out so far. If the input is a scan, these came before it.
    pub left_out: usize,
}

/// What [`Feed::next`] returns.
#[derive(Debug)]
pub enum Next {
    /// An input, and when it came.
    Incoming(Box<Input>, Arrival),
    /// Nothing came in the time given.
    Nothing,
    /// The transport has ended, and nothing waits.
    End,
}

/// A transport on a thread of its own, and what came from it and was not taken yet.
#[derive(Debug)]
pub struct Feed {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug, Default)]
struct Shared {
    queue: Mutex<Queue>,
    came: Condvar,
    taken: Condvar,
}

#[derive(Debug, Default)]
struct Queue {
    /// Each with when it came and its number.
    waiting: VecDeque<(Box<Input>, Instant, u64)>,
    /// Inputs that came.
    came: u64,
    counts: FeedCounts,
    pause: Pause,
    stopped: bool,
    ended: bool,
}

/// When more scans may wait than usual.
#[derive(Clone, Copy, Debug, Default)]
struct Pause {
    /// When a pause began that has not ended.
    begun: Option<Instant>,
    /// Until when the scans that came in the last one may wait.
    until: Option<Instant>,
}

impl Pause {
    fn begin(&mut self, now: Instant) {
        self.begun = Some(now);
    }

    /// What came in the pause may wait for as long again as it took, in which it is to be worked off: it is if scans come half as fast as they can be mapped.
    fn end(&mut self, now: Instant, waiting: usize) {
        let took = self.begun.take().map(|begun| now.saturating_duration_since(begun));
        if waiting > WAITING_SCANS {
            self.until = took.map(|took| now + took).max(self.until);
        }
    }

    /// Scans that may wait now, of which the oldest came at a time.
    fn most(&self, oldest: Option<Instant>, now: Instant) -> usize {
        let is_long = self.begun.is_some() || self.until.is_some_and(|until| now < until);
        let is_burst = oldest.is_none_or(|came| now.saturating_duration_since(came) < BURST);
        match (is_long, is_burst) {
            (true, _) => WAITING_IN_PAUSE,
            (_, true) => WAITING_IN_BURST,
            _ => WAITING_SCANS,
        }
    }
}

impl Queue {
    /// The position of the oldest scan that waits. There are few scans, but edges may be between them.
    fn oldest_scan(&self) -> Option<usize> {
        self.waiting.iter().position(|(input, ..)| input.time().is_some())
    }
}

impl Feed {
    /// Starts the transport.
    ///
    /// # Errors
    /// When the system has no thread for it.
    pub fn start(transport: Box<dyn Transport>, overload: Overload) -> io::Result<Self> {
        let shared = Arc::new(Shared::default());
        let end = End(Arc::clone(&shared));
        let thread = std::thread::Builder::new().name("transport".to_owned()).spawn(move || end.0.run(transport, overload))?;
        Ok(Self { shared, thread: Some(thread) })
    }

    /// The next input in the order in which they came; waits for one for at most `patience`.
    pub fn next(&self, patience: Duration) -> Next {
        let until = Instant::now() + patience;
        let mut queue = self.shared.lock();
        loop {
            if let Some((input, at, number)) = queue.waiting.pop_front() {
                queue.counts.waiting -= usize::from(input.time().is_some());
                self.shared.taken.notify_all();
                return Next::Incoming(input, Arrival { at, number, left_out: queue.counts.left_out });
            }
            if queue.ended {
                return Next::End;
            }
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Next::Nothing;
            }
            queue = self.shared.came.wait_timeout(queue, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// The mapper does something else now, such as writing a checkpoint: more scans may wait.
    pub fn begin_pause(&self) {
        self.shared.lock().pause.begin(Instant::now());
    }

    /// The mapper goes on. What waits may wait for as long again as the pause took.
    pub fn end_pause(&self) {
        let mut queue = self.shared.lock();
        let waiting = queue.counts.waiting;
        queue.pause.end(Instant::now(), waiting);
    }

    /// Asks the transport to end. What waits can still be taken.
    pub fn stop(&self) {
        self.shared.lock().stopped = true;
        self.shared.taken.notify_all();
    }

    /// The counts so far.
    pub fn counts(&self) -> FeedCounts {
        self.shared.lock().counts
    }
}

impl Drop for Feed {
    fn drop(&mut self) {
        self.stop();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Marks the feed as ended when the thread ends, however it ends.
struct End(Arc<Shared>);

impl Drop for End {
    fn drop(&mut self) {
        self.0.lock().ended = true;
        self.0.came.notify_all();
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn run(&self, mut transport: Box<dyn Transport>, overload: Overload) {
        let is_stopped = || self.lock().stopped;
        while let Some(input) = transport.next(&is_stopped) {
            if !self.put(input, overload) {
                return;
            }
        }
    }

    /// Adds an input to the queue; false if the feed was stopped meanwhile.
    fn put(&self, input: Input, overload: Overload) -> bool {
        let (at, is_scan) = (Instant::now(), input.time().is_some());
        let mut queue = self.lock();
        let waits = |queue: &Queue| {
            let others = queue.waiting.len() - queue.counts.waiting;
            others >= WAITING_OTHERS || is_scan && overload == Overload::Wait && queue.counts.waiting >= WAITING_SCANS
        };
        while waits(&queue) && !queue.stopped {
            queue = self.taken.wait_timeout(queue, LOOK).unwrap_or_else(PoisonError::into_inner).0;
        }
        if queue.stopped {
            return false;
        }
        if is_scan {
            queue.counts.scans += 1;
            let oldest_came = queue.oldest_scan().map(|oldest| queue.waiting[oldest].1);
            let most = queue.pause.most(oldest_came, at);
            while queue.counts.waiting >= most {
                let oldest = queue.oldest_scan();
                oldest.and_then(|oldest| queue.waiting.remove(oldest));
                queue.counts.left_out += 1;
                queue.counts.waiting -= 1;
            }
            queue.counts.waiting += 1;
        }
        queue.came += 1;
        let number = queue.came;
        queue.waiting.push_back((Box::new(input), at, number));
        self.came.notify_one();
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use voxelastic::event::{Edge, Event, Scan};
    use voxelastic::{Cloud, Pose};

    /// Gives out nodes as scans, each followed by an edge, without waiting.
    struct Burst(u64, bool);

    impl Transport for Burst {
        fn next(&mut self, _: &dyn Fn() -> bool) -> Option<Input> {
            let node = self.0;
            self.1 = !self.1;
            let scan = Event::Scan(Scan { node, time: node as f64, t_map_lidar: Pose::identity(), cloud: Cloud::default() });
            let edge = Event::OdometryEdge(Edge { from: node, to: node + 1, t_from_to: Pose::identity(), information: None });
            self.0 += u64::from(!self.1);
            (node < 100).then_some(Input::Event(if self.1 { scan } else { edge }))
        }
    }

    fn take_all(feed: &Feed) -> (Vec<u64>, Vec<u64>) {
        let (mut scans, mut edges) = (Vec::new(), Vec::new());
        loop {
            match feed.next(Duration::from_secs(10)) {
                Next::Incoming(incoming, arrival) => match *incoming {
                    Input::Event(Event::Scan(scan)) => {
                        assert_eq!(arrival.number, 2 * scan.node + 1);
                        assert_eq!(arrival.left_out, scan.node as usize - scans.len(), "those left out are older");
                        scans.push(scan.node);
                    }
                    Input::Event(Event::OdometryEdge(edge)) => edges.push(edge.from),
                    other => panic!("{other:?}"),
                },
                Next::End => return (scans, edges),
                Next::Nothing => panic!("ten seconds without an input"),
            }
        }
    }

    #[test]
    fn the_newest_scans_win_and_edges_stay() {
        let feed = Feed::start(Box::new(Burst(0, false)), Overload::NewestWin).unwrap();
        while !feed.shared.lock().ended {
            std::thread::sleep(Duration::from_millis(1));
        }
        assert_eq!(feed.counts(), FeedCounts { scans: 100, left_out: 100 - WAITING_IN_BURST, waiting: WAITING_IN_BURST });
        let (scans, edges) = take_all(&feed);
        assert_eq!(scans, (84..100).collect::<Vec<_>>());
        assert_eq!(edges, (0..100).collect::<Vec<_>>());
        assert_eq!(feed.counts().waiting, 0);
    }

    #[test]
    fn more_scans_wait_while_the_mapper_does_something_else() {
        /// A burst that begins when it may.
        struct Later(Burst, std::sync::mpsc::Receiver<()>);
        impl Transport for Later {
            fn next(&mut self, is_stopped: &dyn Fn() -> bool) -> Option<Input> {
                let _ = self.1.recv();
                self.0.next(is_stopped)
            }
        }
        let (begin, may) = std::sync::mpsc::channel();
        let feed = Feed::start(Box::new(Later(Burst(0, false), may)), Overload::NewestWin).unwrap();
        feed.begin_pause();
        drop(begin);
        while !feed.shared.lock().ended {
            std::thread::sleep(Duration::from_millis(1));
        }
        feed.end_pause();
        assert_eq!(feed.counts(), FeedCounts { scans: 100, left_out: 100 - WAITING_IN_PAUSE, waiting: WAITING_IN_PAUSE });
        assert_eq!(take_all(&feed).0, (36..100).collect::<Vec<_>>());
    }

    #[test]
    fn what_came_in_a_pause_has_as_long_again_to_be_worked_off() {
        let (mut pause, begin, second) = (Pause::default(), Instant::now(), Duration::from_secs(1));
        // The oldest scan came a second before.
        let most = |pause: &Pause, now: Instant| pause.most(Some(now - second), now);
        assert_eq!(most(&pause, begin + second), WAITING_SCANS);
        pause.begin(begin);
        assert_eq!(most(&pause, begin + 100 * second), WAITING_IN_PAUSE);
        pause.end(begin + 3 * second, 30);
        assert_eq!([5, 6].map(|k| most(&pause, begin + k * second)), [WAITING_IN_PAUSE, WAITING_SCANS]);
        // One in which no more came than usual changes nothing.
        pause.begin(begin + 10 * second);
        pause.end(begin + 20 * second, WAITING_SCANS);
        assert_eq!(most(&pause, begin + 21 * second), WAITING_SCANS);
    }

    #[test]
    fn what_comes_at_once_may_wait_and_what_waits_for_long_may_not() {
        let (pause, now) = (Pause::default(), Instant::now() + Duration::from_secs(1));
        let most = |ms: u64| pause.most(Some(now - Duration::from_millis(ms)), now);
        assert_eq!([most(0), most(399), most(400)], [WAITING_IN_BURST, WAITING_IN_BURST, WAITING_SCANS]);
        assert_eq!(pause.most(None, now), WAITING_IN_BURST);
    }

    #[test]
    fn a_recording_can_be_taken_whole() {
        let feed = Feed::start(Box::new(Burst(0, false)), Overload::Wait).unwrap();
        std::thread::sleep(Duration::from_millis(20));
        assert!(feed.counts().scans <= WAITING_SCANS);
        let (scans, edges) = take_all(&feed);
        assert_eq!((scans.clone(), edges), ((0..100).collect(), (0..100).collect()));
        assert_eq!(feed.counts(), FeedCounts { scans: 100, left_out: 0, waiting: 0 });
    }

    #[test]
    fn nothing_is_not_the_end_and_a_feed_that_waits_can_be_stopped() {
        /// Never has anything.
        struct Silence;
        impl Transport for Silence {
            fn next(&mut self, is_stopped: &dyn Fn() -> bool) -> Option<Input> {
                while !is_stopped() {
                    std::thread::sleep(Duration::from_millis(1));
                }
                None
            }
        }
        let feed = Feed::start(Box::new(Silence), Overload::NewestWin).unwrap();
        assert!(matches!(feed.next(Duration::from_millis(5)), Next::Nothing));
        feed.stop();
        assert!(matches!(feed.next(Duration::from_secs(10)), Next::End));
        // One that waits for room, too.
        drop(Feed::start(Box::new(Burst(0, false)), Overload::Wait).unwrap());
    }

    #[test]
    fn a_transport_that_panics_ends_the_feed() {
        struct Broken;
        impl Transport for Broken {
            fn next(&mut self, _: &dyn Fn() -> bool) -> Option<Input> {
                panic!("on purpose")
            }
        }
        let feed = Feed::start(Box::new(Broken), Overload::NewestWin).unwrap();
        assert!(matches!(feed.next(Duration::from_secs(10)), Next::End));
    }
}
