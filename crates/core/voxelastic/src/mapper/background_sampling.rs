//! Samples the source of a fusion on a thread of the lowest priority, ahead of the scans that merge it.
//!
//! A scan never waits for that thread: under load the system may not schedule it for seconds. What is not ready when it is needed is sampled by
//! the scan's own threads, with the same result. So the two sides share no lock that a scan waits for: a scan tries a lock, and takes one
//! that is held for a part that is not ready.

use crate::atlas::Submap;
use crate::atlas::fusion::{Resampled, SamplingPlan};
use crate::geometry::Pose;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::thread::Thread;

/// Sampled parts that may wait to be merged: parts that are sampled and not merged take memory.
const PARTS_AHEAD: usize = 4;

/// The parts of a fusion's source, in order.
#[derive(Debug)]
pub(super) struct BackgroundSampling {
    source: Arc<Submap>,
    t_target_source: Pose,
    shared: Arc<Shared>,
    /// Parts sampled here that are not asked for yet.
    ahead: VecDeque<Resampled>,
    /// Number of parts taken.
    taken: usize,
}

/// What a scan and the thread share.
#[derive(Debug, Default)]
struct Shared {
    /// The first part that is not taken or sampled by a scan; [`STOP`] ends the thread.
    needed: AtomicUsize,
    plan: Mutex<Option<SamplingPlan>>,
    /// Part `n`, with its number, is in slot `n % PARTS_AHEAD`.
    slots: [Mutex<Option<(usize, Resampled)>>; PARTS_AHEAD],
    thread: OnceLock<Thread>,
}

/// The value of [`Shared::needed`] when nobody asks for parts any more.
const STOP: usize = usize::MAX;

impl BackgroundSampling {
    /// Begins to sample `source`, which lies at `t_target_source`, in `worker`; without one, every part is sampled when it is asked for.
    pub fn start(source: Arc<Submap>, t_target_source: Pose, worker: Option<&rayon::ThreadPool>) -> Self {
        let sampling = Self { source, t_target_source, shared: Arc::default(), ahead: VecDeque::new(), taken: 0 };
        if let Some(worker) = worker {
            let (source, shared) = (Arc::clone(&sampling.source), Arc::clone(&sampling.shared));
            worker.spawn(move || shared.sample_ahead(&source, &t_target_source));
        }
        sampling
    }

    /// Number of parts taken.
    pub fn taken(&self) -> usize {
        self.taken
    }

    /// The next part, and whether it is the last one. After the last one, empty parts follow.
    pub fn next_part(&mut self) -> (Resampled, bool) {
        let plan = self.plan();
        let sampling = plan.of(&self.source);
        let (number, parts) = (self.taken, sampling.parts());
        if number >= parts {
            return (Resampled::default(), true);
        }
        if self.ahead.is_empty() {
            match self.shared.take(number) {
                Some(part) => self.ahead.push_back(part),
                // One part a thread, because the next ones will hardly be ready, either.
                None => self.ahead.extend(sampling.parts_in(number..parts.min(number + rayon::current_num_threads()))),
            }
            self.shared.need(number + self.ahead.len());
        }
        self.taken += 1;
        (self.ahead.pop_front().unwrap_or_default(), self.taken >= parts)
    }

    /// The thread's plan, or one made here.
    fn plan(&self) -> SamplingPlan {
        let made = self.shared.plan.try_lock().ok().and_then(|plan| plan.clone());
        made.unwrap_or_else(|| {
            let plan = SamplingPlan::new(&self.source, &self.t_target_source);
            if let Ok(mut shared) = self.shared.plan.try_lock() {
                *shared = Some(plan.clone());
            }
            plan
        })
    }
}

impl Drop for BackgroundSampling {
    fn drop(&mut self) {
        self.shared.need(STOP);
    }
}

impl Shared {
    /// Part `number`, if it is ready.
    fn take(&self, number: usize) -> Option<Resampled> {
        let mut slot = self.slots[number % PARTS_AHEAD].try_lock().ok()?;
        slot.take_if(|(n, _)| *n == number).map(|(_, part)| part)
    }

    /// Tells the thread which part is needed next.
    fn need(&self, number: usize) {
        self.needed.store(number, Ordering::Release);
        if let Some(thread) = self.thread.get() {
            thread.unpark();
        }
    }

    /// Samples the parts that are needed next until there are no more.
    fn sample_ahead(&self, source: &Submap, t_target_source: &Pose) {
        // The only thread that sets it.
        let _ = self.thread.set(std::thread::current());
        let plan = SamplingPlan::new(source, t_target_source);
        let sampling = plan.of(source);
        *self.plan.lock().unwrap_or_else(PoisonError::into_inner) = Some(plan);
        let mut next = 0;
        loop {
            let needed = self.needed.load(Ordering::Acquire);
            next = next.max(needed);
            if next >= sampling.parts() {
                return;
            }
            if next >= needed + PARTS_AHEAD {
                std::thread::park();
                continue;
            }
            let part = sampling.part(next);
            *self.slots[next % PARTS_AHEAD].lock().unwrap_or_else(PoisonError::into_inner) = Some((next, part));
            next += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::atlas::fusion::Sampling;
    use crate::geometry::Rigid;
    use crate::integrate::{ReturnsView, TsdfIntegrator, TsdfSettings};
    use std::sync::mpsc::channel;

    /// A submap of a floor of 60 x 60 m.
    fn floor() -> Arc<Submap> {
        let points: Vec<[f32; 3]> = (0..600 * 600).map(|i| [(i % 600) as f32 * 0.1 - 30.0, (i / 600) as f32 * 0.1 - 30.0, -2.0]).collect();
        let normals = vec![[0.0, 0.0, 1.0]; points.len()];
        let identity = Rigid { rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], translation: [0.0; 3] };
        let returns = ReturnsView::of_points(&points, &normals, 0.003);
        let mut submap = Submap::new(0, 0.1, Pose::identity());
        TsdfIntegrator::new(TsdfSettings { voxel_size: 0.1, ..TsdfSettings::default() }).integrate(&mut submap.tsdf, &identity, &returns);
        Arc::new(submap)
    }

    fn pose() -> Pose {
        Pose::new(nalgebra::Vector3::new(3.0, -1.0, 0.05), nalgebra::Vector3::new(0.0, 0.0, 0.4))
    }

    /// All parts that `sampling` gives, as text; `before` is called before each with its number.
    fn parts(sampling: &mut BackgroundSampling, mut before: impl FnMut(usize)) -> Vec<String> {
        let mut found = Vec::new();
        loop {
            before(sampling.taken());
            let (part, is_last) = sampling.next_part();
            found.push(format!("{part:?}"));
            if is_last {
                return found;
            }
        }
    }

    fn worker() -> rayon::ThreadPool {
        rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap()
    }

    #[test]
    fn parts_are_the_same_however_fast_the_thread_is() {
        let source = floor();
        let reference = Sampling::new(&source, &pose());
        let expected: Vec<String> = (0..reference.parts()).map(|number| format!("{:?}", reference.part(number))).collect();
        assert!(expected.len() > 3 * PARTS_AHEAD, "{} parts", expected.len());
        let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
        for threads in [None, Some(worker())] {
            for is_slow in [false, true] {
                let mut sampling = BackgroundSampling::start(Arc::clone(&source), pose(), threads.as_ref());
                // A slow taker lets the thread get as far ahead as it may.
                let pause = |number: usize| {
                    if is_slow && number.is_multiple_of(5) {
                        std::thread::sleep(std::time::Duration::from_millis(40));
                    }
                };
                let found = pool.install(|| parts(&mut sampling, pause));
                assert!(found == expected, "{} threads", threads.iter().count());
                assert!(sampling.next_part().0.is_empty());
            }
        }
    }

    #[test]
    fn nobody_waits_for_a_thread_that_is_never_scheduled() {
        let source = floor();
        let expected = parts(&mut BackgroundSampling::start(Arc::clone(&source), pose(), None), |_| ());
        // The thread is busy with something else until the end.
        let worker = worker();
        let (release, held) = channel::<()>();
        worker.spawn(move || held.recv().unwrap());
        let mut sampling = BackgroundSampling::start(Arc::clone(&source), pose(), Some(&worker));
        assert!(parts(&mut sampling, |_| ()) == expected);
        // Nor for one that is stopped while it holds a lock.
        let mut sampling = BackgroundSampling::start(source, pose(), None);
        let shared = Arc::clone(&sampling.shared);
        let (_plan, _slot) = (shared.plan.lock(), shared.slots[1].lock());
        assert!(parts(&mut sampling, |_| ()) == expected);
        release.send(()).unwrap();
    }

    #[test]
    fn the_thread_ends_when_the_fusion_is_dropped() {
        let source = floor();
        let worker = worker();
        let sampling = BackgroundSampling::start(Arc::clone(&source), pose(), Some(&worker));
        drop(sampling);
        // Runs after the sampling has returned.
        worker.install(|| ());
        assert_eq!(Arc::strong_count(&source), 1);
    }
}
