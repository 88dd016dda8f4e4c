//! Work beside the mapper, on copies of what it needs, so that no scan waits for it.

use std::fmt;
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};

/// How much of a core that it shares with a scan a worker gets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Priority {
    /// As much as the scan.
    Usual,
    /// About a tenth of the time, so that there is something to see even if scans come as fast as they can be mapped.
    Low,
}

/// A thread that makes what is ordered, with helpers of its own. It ends with its owner.
pub(crate) struct Worker<Order, Made> {
    orders: Sender<Order>,
    made: Receiver<Made>,
    is_busy: bool,
}

impl<Order: Send + 'static, Made: Send + 'static> Worker<Order, Made> {
    /// Starts it with `threads` threads, all called `name`: what it makes is said not to be shown if it does not start.
    pub fn start(name: &'static str, threads: usize, priority: Priority, mut make: impl FnMut(Order) -> Made + Send + 'static) -> Self {
        let (orders, to_make) = channel::<Order>();
        let (sender, made) = channel();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).thread_name(|_| name.to_owned());
        let pool = pool
            .start_handler(move |_| {
                if priority == Priority::Low {
                    lower_priority()
                }
            })
            .build();
        let work = move || {
            while let Ok(order) = to_make.recv() {
                let made = match &pool {
                    Ok(pool) => pool.install(|| make(order)),
                    // Without threads of its own it shares those of others.
                    Err(_) => make(order),
                };
                if sender.send(made).is_err() {
                    return;
                }
            }
        };
        // If it does not start, orders are lost.
        if let Err(problem) = std::thread::Builder::new().name(name.to_owned()).spawn(work) {
            tracing::warn!("the {name} cannot be shown: {problem}");
        }
        Self { orders, made, is_busy: false }
    }

    /// Whether something is being made.
    pub fn is_busy(&self) -> bool {
        self.is_busy
    }

    /// Has something made. To be called only while it is not busy.
    pub fn order(&mut self, order: Order) {
        self.is_busy = self.orders.send(order).is_ok();
    }

    /// What was ordered, if it is made. Does not wait.
    pub fn made(&mut self) -> Option<Made> {
        if !self.is_busy {
            return None;
        }
        let made = self.made.try_recv();
        self.is_busy = matches!(made, Err(TryRecvError::Empty));
        made.ok()
    }
}

impl<Order, Made> fmt::Debug for Worker<Order, Made> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Worker").field("is_busy", &self.is_busy).finish_non_exhaustive()
    }
}

/// Gives the calling thread a [low priority](Priority::Low). If the system refuses, the priority stays as it is.
pub(crate) fn lower_priority() {
    #[cfg(target_os = "linux")]
    let _ = rustix::process::nice(10);
}
