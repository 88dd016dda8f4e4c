//! Reading ahead: items are produced before they are requested, on a thread of their own or in the idle time of other threads.

use std::collections::VecDeque;
use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;

/// Reads one item ahead in the time of the calling thread and returns whether there was one to read.
///
/// Meant for threads that would otherwise be idle, such as those of a mapper's pool between the steps of a scan. May be called from any number
/// of threads. If it is taken before the first item, the iterator starts no thread of its own.
pub type IdleStep = Box<dyn Fn() -> bool + Send + Sync>;

/// The items of an iterator, in order, produced up to a given number ahead.
pub(crate) struct ReadAhead<T> {
    shared: Arc<Shared<T>>,
    /// Whether items are produced other than in `next`.
    has_producer: bool,
}

struct Shared<T> {
    name: &'static str,
    most: usize,
    panicked: fn(String) -> T,
    state: Mutex<State<T>>,
    changed: Condvar,
    /// Whether an item should be produced; may be read without taking the lock.
    is_due: AtomicBool,
}

struct State<T> {
    /// `None` while an item is being produced.
    items: Option<Box<dyn Iterator<Item = T> + Send>>,
    ready: VecDeque<T>,
    /// There are no more items, or the consumer is gone.
    is_over: bool,
}

impl<T: Send + 'static> ReadAhead<T> {
    /// Reads `items` at most `most` ahead. A thread called `name` does so from the first call of `next` on, unless an
    /// [idle step](Self::idle_step) was taken before.
    ///
    /// A panic of `items` is the bug of a decoder. It becomes a last item that `panicked` makes of its message.
    pub fn new(name: &'static str, most: usize, items: impl Iterator<Item = T> + Send + 'static, panicked: fn(String) -> T) -> Self {
        let state = State { items: Some(Box::new(items)), ready: VecDeque::new(), is_over: false };
        let shared = Shared { name, most, panicked, state: Mutex::new(state), changed: Condvar::new(), is_due: AtomicBool::new(true) };
        Self { shared: Arc::new(shared), has_producer: false }
    }

    /// A function that produces one item ahead.
    pub fn idle_step(&mut self) -> IdleStep {
        self.has_producer = true;
        let shared = Arc::clone(&self.shared);
        Box::new(move || shared.is_due.load(Ordering::Relaxed) && shared.produce_one())
    }

    fn start_thread(&mut self) {
        self.has_producer = true;
        let shared = Arc::clone(&self.shared);
        let produce = move || {
            while shared.wait_until_due() {
                shared.produce_one();
            }
        };
        // If no thread can be started, items are produced on request.
        drop(thread::Builder::new().name(self.shared.name.into()).spawn(produce));
    }
}

impl<T: Send + 'static> Iterator for ReadAhead<T> {
    type Item = T;

    fn next(&mut self) -> Option<T> {
        if !self.has_producer {
            self.start_thread();
        }
        let shared = &self.shared;
        let mut state = shared.lock();
        loop {
            if let Some(item) = state.ready.pop_front() {
                shared.notify(&state);
                return Some(item);
            }
            if state.is_over {
                return None;
            }
            state = match state.items.take() {
                Some(items) => {
                    drop(state);
                    shared.produce(items);
                    shared.lock()
                }
                None => shared.changed.wait(state).unwrap_or_else(PoisonError::into_inner),
            };
        }
    }
}

impl<T> Drop for ReadAhead<T> {
    fn drop(&mut self) {
        let mut state = self.shared.lock();
        state.is_over = true;
        // Idle steps may outlive this; files and decoded clouds must not.
        let left = (state.items.take(), std::mem::take(&mut state.ready));
        self.shared.notify(&state);
        drop((state, left));
    }
}

impl<T> fmt::Debug for ReadAhead<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ReadAhead").field("name", &self.shared.name).field("ready", &self.shared.lock().ready.len()).finish_non_exhaustive()
    }
}

impl<T> Shared<T> {
    /// No code panics while it holds the lock, so a poisoned lock is ignored.
    fn lock(&self) -> MutexGuard<'_, State<T>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn is_due(&self, state: &State<T>) -> bool {
        state.items.is_some() && state.ready.len() < self.most && !state.is_over
    }

    /// Tells the other threads that the state changed.
    fn notify(&self, state: &State<T>) {
        self.is_due.store(self.is_due(state), Ordering::Relaxed);
        self.changed.notify_all();
    }

    /// Waits until an item should be produced; false when there will be no more.
    fn wait_until_due(&self) -> bool {
        let waits = |state: &mut State<T>| !state.is_over && !self.is_due(state);
        let state = self.changed.wait_while(self.lock(), waits);
        !state.unwrap_or_else(PoisonError::into_inner).is_over
    }

    fn produce_one(&self) -> bool {
        let mut state = self.lock();
        if !self.is_due(&state) {
            return false;
        }
        let Some(items) = state.items.take() else { return false };
        self.notify(&state);
        drop(state);
        self.produce(items);
        true
    }

    /// Produces the next item and puts `items` back. A panic ends the sequence after an item that says so: it must neither block the consumer nor
    /// unwind into an idle thread, nor look like the end of the data.
    fn produce(&self, mut items: Box<dyn Iterator<Item = T> + Send>) {
        let item = catch_unwind(AssertUnwindSafe(|| items.next()));
        let mut state = self.lock();
        let item = match item {
            Ok(item) => item,
            Err(payload) => {
                let words = payload.downcast_ref::<&str>().copied().or_else(|| payload.downcast_ref::<String>().map(String::as_str));
                if !state.is_over {
                    state.ready.push_back((self.panicked)(words.unwrap_or("no details").to_owned()));
                }
                None
            }
        };
        state.is_over |= item.is_none();
        if !state.is_over {
            state.ready.extend(item);
            state.items = Some(items);
        }
        self.notify(&state);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicUsize;
    use std::time::Duration;

    /// Numbers below `end`, and how many of them were produced.
    fn numbers(end: usize) -> (Arc<AtomicUsize>, impl Iterator<Item = usize> + Send) {
        let made = Arc::new(AtomicUsize::new(0));
        let count = Arc::clone(&made);
        let tally = move |_: &usize| {
            count.fetch_add(1, Ordering::Relaxed);
        };
        (made, (0..end).inspect(tally))
    }

    fn no_panic(words: String) -> usize {
        panic!("{words}")
    }

    /// Waits until `made` is `expected`, for at most ten seconds.
    fn soon(made: &AtomicUsize, expected: usize) -> bool {
        (0..1000).any(|_| {
            thread::sleep(Duration::from_millis(10));
            made.load(Ordering::Relaxed) == expected
        })
    }

    #[test]
    fn a_thread_reads_a_limited_number_ahead() {
        let (made, items) = numbers(100);
        let mut ahead = ReadAhead::new("test", 3, items, no_panic);
        assert_eq!(ahead.next(), Some(0));
        assert!(soon(&made, 4), "{made:?}");
        thread::sleep(Duration::from_millis(30));
        assert_eq!(made.load(Ordering::Relaxed), 4);
        assert_eq!(ahead.collect::<Vec<_>>(), (1..100).collect::<Vec<_>>());
        assert_eq!(made.load(Ordering::Relaxed), 100);
    }

    #[test]
    fn an_idle_step_produces_one_item_and_no_thread_is_started() {
        let (made, items) = numbers(4);
        let mut ahead = ReadAhead::new("test", 2, items, no_panic);
        let step = ahead.idle_step();
        assert!(step() && step() && !step());
        assert_eq!((ahead.next(), ahead.next(), made.load(Ordering::Relaxed)), (Some(0), Some(1), 2));
        assert_eq!(ahead.next(), Some(2), "produced on request");
        assert!(step(), "the last one");
        assert!(step() && !step(), "that there are no more");
        assert_eq!((ahead.next(), ahead.next()), (Some(3), None));
    }

    #[test]
    fn idle_steps_of_many_threads_keep_the_order() {
        let (_, items) = numbers(2000);
        let mut ahead = ReadAhead::new("test", 2, items, no_panic);
        let steps: Vec<IdleStep> = (0..3).map(|_| ahead.idle_step()).collect();
        let is_done = AtomicBool::new(false);
        let taken = thread::scope(|scope| {
            for step in &steps {
                scope.spawn(|| {
                    while !is_done.load(Ordering::Relaxed) {
                        std::hint::black_box(step());
                    }
                });
            }
            let taken: Vec<usize> = ahead.by_ref().collect();
            is_done.store(true, Ordering::Relaxed);
            taken
        });
        assert_eq!(taken, (0..2000).collect::<Vec<_>>());
    }

    #[test]
    fn nothing_is_produced_after_the_consumer_is_gone() {
        let (made, items) = numbers(100);
        let mut ahead = ReadAhead::new("test", 2, items, no_panic);
        let step = ahead.idle_step();
        assert!(step());
        drop(ahead);
        assert!(!step());
        assert_eq!(made.load(Ordering::Relaxed), 1);
        assert_eq!(Arc::strong_count(&made), 1, "an idle step that outlives the iterator does not hold what it read");
        let (_, items) = numbers(100);
        let mut ahead = ReadAhead::new("test", 2, items, no_panic);
        let shared = Arc::clone(&ahead.shared);
        ahead.next();
        drop(ahead);
        let is_gone = || Arc::strong_count(&shared) == 1;
        assert!(
            (0..1000).any(|_| is_gone() || {
                thread::sleep(Duration::from_millis(10));
                false
            }),
            "the thread has ended"
        );
    }

    #[test]
    fn a_panic_ends_the_sequence_with_an_error_and_keeps_finished_items() {
        let items = (0..5).inspect(|i| assert!(*i < 2, "on purpose")).map(Ok);
        let all = ReadAhead::new("test", 2, items, Err).collect::<Vec<_>>();
        assert_eq!(all, [Ok(0), Ok(1), Err("on purpose".to_owned())]);
    }
}
