//! Reading ahead: items are made before they are asked for, by a thread of its own or in the spare time of other threads.

use std::collections::VecDeque;
use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use voxelastic::mapper::Chore;

/// What an iterator gives, in its order, made up to so many items ahead.
pub(crate) struct ReadAhead<T> {
    shared: Arc<Shared<T>>,
    /// Whether somebody makes items, besides those who ask for them.
    has_maker: bool,
}

struct Shared<T> {
    name: &'static str,
    most: usize,
    state: Mutex<State<T>>,
    changed: Condvar,
    /// Whether there is something to make ahead, for those who would rather not wait to be told.
    is_due: AtomicBool,
}

struct State<T> {
    /// Taken while an item is being made.
    items: Option<Box<dyn Iterator<Item = T> + Send>>,
    ready: VecDeque<T>,
    /// There will be no more items, or nobody takes them.
    is_over: bool,
}

impl<T: Send + 'static> ReadAhead<T> {
    /// `items`, of which `most` may wait. Unless a [chore](Self::chore) is taken before, a thread called `name` makes them from the first call of `next` on.
    pub fn new(name: &'static str, most: usize, items: impl Iterator<Item = T> + Send + 'static) -> Self {
        let state = State { items: Some(Box::new(items)), ready: VecDeque::new(), is_over: false };
        let shared = Shared { name, most, state: Mutex::new(state), changed: Condvar::new(), is_due: AtomicBool::new(true) };
        Self { shared: Arc::new(shared), has_maker: false }
    }

    /// Making one item ahead, for threads with time to spare. Taken before the first item, there is no thread for it.
    pub fn chore(&mut self) -> Chore {
        self.has_maker = true;
        let shared = Arc::clone(&self.shared);
        Chore::new(move || shared.is_due.load(Ordering::Relaxed) && shared.make_one_ahead())
    }

    fn start_thread(&mut self) {
        self.has_maker = true;
        let shared = Arc::clone(&self.shared);
        let make = move || {
            while shared.wait_until_due() {
                shared.make_one_ahead();
            }
        };
        // Without a thread, items are made when they are asked for.
        drop(thread::Builder::new().name(self.shared.name.into()).spawn(make));
    }
}

impl<T: Send + 'static> Iterator for ReadAhead<T> {
    type Item = T;

    fn next(&mut self) -> Option<T> {
        if !self.has_maker {
            self.start_thread();
        }
        let shared = &self.shared;
        let mut state = shared.lock();
        loop {
            if let Some(item) = state.ready.pop_front() {
                shared.tell(&state);
                return Some(item);
            }
            if state.is_over {
                return None;
            }
            state = match state.items.take() {
                Some(items) => {
                    drop(state);
                    shared.make(items);
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
        // A chore may live on, but not what it would read: files, and clouds that nobody takes.
        let left = (state.items.take(), std::mem::take(&mut state.ready));
        self.shared.tell(&state);
        drop((state, left));
    }
}

impl<T> fmt::Debug for ReadAhead<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ReadAhead").field("name", &self.shared.name).field("ready", &self.shared.lock().ready.len()).finish_non_exhaustive()
    }
}

impl<T> Shared<T> {
    /// Nothing panics that holds the lock.
    fn lock(&self) -> MutexGuard<'_, State<T>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn is_due(&self, state: &State<T>) -> bool {
        state.items.is_some() && state.ready.len() < self.most && !state.is_over
    }

    /// Lets the others know that the state changed.
    fn tell(&self, state: &State<T>) {
        self.is_due.store(self.is_due(state), Ordering::Relaxed);
        self.changed.notify_all();
    }

    /// Waits for something to make; false when there will never be any.
    fn wait_until_due(&self) -> bool {
        let waits = |state: &mut State<T>| !state.is_over && !self.is_due(state);
        let state = self.changed.wait_while(self.lock(), waits);
        !state.unwrap_or_else(PoisonError::into_inner).is_over
    }

    fn make_one_ahead(&self) -> bool {
        let mut state = self.lock();
        if !self.is_due(&state) {
            return false;
        }
        let Some(items) = state.items.take() else { return false };
        self.tell(&state);
        drop(state);
        self.make(items);
        true
    }

    /// Makes the next item, and gives the `items` back for those that follow. Should it panic, there are no more: who waits is not to wait for ever,
    /// and who had time to spare is not to blame.
    fn make(&self, mut items: Box<dyn Iterator<Item = T> + Send>) {
        let item = catch_unwind(AssertUnwindSafe(|| items.next())).unwrap_or(None);
        let mut state = self.lock();
        state.is_over |= item.is_none();
        if !state.is_over {
            state.ready.extend(item);
            state.items = Some(items);
        }
        self.tell(&state);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicUsize;
    use std::time::Duration;

    /// Numbers below `end`, and how many of them were made.
    fn numbers(end: usize) -> (Arc<AtomicUsize>, impl Iterator<Item = usize> + Send) {
        let made = Arc::new(AtomicUsize::new(0));
        let count = Arc::clone(&made);
        let tally = move |_: &usize| {
            count.fetch_add(1, Ordering::Relaxed);
        };
        (made, (0..end).inspect(tally))
    }

    /// Waits until `made` is `expected`, for at most ten seconds.
    fn soon(made: &AtomicUsize, expected: usize) -> bool {
        (0..1000).any(|_| {
            thread::sleep(Duration::from_millis(10));
            made.load(Ordering::Relaxed) == expected
        })
    }

    #[test]
    fn a_thread_makes_so_many_items_ahead_and_no_more() {
        let (made, items) = numbers(100);
        let mut ahead = ReadAhead::new("test", 3, items);
        assert_eq!(ahead.next(), Some(0));
        assert!(soon(&made, 4), "{made:?}");
        thread::sleep(Duration::from_millis(30));
        assert_eq!(made.load(Ordering::Relaxed), 4);
        assert_eq!(ahead.collect::<Vec<_>>(), (1..100).collect::<Vec<_>>());
        assert_eq!(made.load(Ordering::Relaxed), 100);
    }

    #[test]
    fn a_chore_makes_one_item_at_a_time_and_no_thread_does() {
        let (made, items) = numbers(4);
        let mut ahead = ReadAhead::new("test", 2, items);
        let chore = ahead.chore();
        assert!(chore.run() && chore.run() && !chore.run());
        assert_eq!((ahead.next(), ahead.next(), made.load(Ordering::Relaxed)), (Some(0), Some(1), 2));
        assert_eq!(ahead.next(), Some(2), "made on the spot");
        assert!(chore.run(), "the last one");
        assert!(chore.run() && !chore.run(), "that there are no more");
        assert_eq!((ahead.next(), ahead.next()), (Some(3), None));
    }

    #[test]
    fn many_threads_with_time_to_spare_keep_the_order() {
        let (_, items) = numbers(2000);
        let mut ahead = ReadAhead::new("test", 2, items);
        let chores: Vec<Chore> = (0..3).map(|_| ahead.chore()).collect();
        let is_done = AtomicBool::new(false);
        let taken = thread::scope(|scope| {
            for chore in &chores {
                scope.spawn(|| {
                    while !is_done.load(Ordering::Relaxed) {
                        std::hint::black_box(chore.run());
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
    fn nothing_is_made_for_nobody() {
        let (made, items) = numbers(100);
        let mut ahead = ReadAhead::new("test", 2, items);
        let chore = ahead.chore();
        assert!(chore.run());
        drop(ahead);
        assert!(!chore.run());
        assert_eq!(made.load(Ordering::Relaxed), 1);
        assert_eq!(Arc::strong_count(&made), 1, "a chore that lives on does not hold what it read");
        let (_, items) = numbers(100);
        let mut ahead = ReadAhead::new("test", 2, items);
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
    fn a_panic_ends_what_was_to_come_and_keeps_what_is_ready() {
        let items = (0..5).inspect(|i| assert!(*i < 2, "on purpose"));
        assert_eq!(ReadAhead::new("test", 2, items).collect::<Vec<_>>(), [0, 1]);
    }
}
