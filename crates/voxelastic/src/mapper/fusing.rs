//! Fusions beside integration (paper Sec. IV-C): sampled by a thread of their own, merged in small steps between scans.
//!
//! A loop closure must not stall integration, and the map must not depend on timing. So what happens when is counted in scans: a fusion
//! begins after the first scan that finds it at the head of the queue and its source at rest, and some scans later every scan merges a
//! fixed number of blocks. The thread is a few parts ahead, no more: what is sampled and not yet merged is memory. Should a part not be
//! there yet, the scan waits for it.

use crate::atlas::cluster::Fusion;
use crate::atlas::fusion::{FusionSettings, Merge, Resampled, Sampling, fuse_from, move_scans};
use crate::atlas::graph::PoseGraph;
use crate::atlas::{Atlas, Submap};
use crate::geometry::Pose;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};

/// Scans between the beginning of a fusion and its first merge, in which the thread finds out what the source reaches.
const HEAD_START: usize = 8;
/// Parts that wait to be merged.
const AHEAD: usize = 2;
/// Blocks merged after each scan: one or two milliseconds, and as many as a thread samples that gets a quarter of a core. Eight times as
/// many made the slowest hundredth of the scans beside fusions take twice the median.
const MERGED_PER_SCAN: usize = 256;

/// The fusions that are due, and the one under way.
#[derive(Debug)]
pub(super) struct Fusing {
    settings: FusionSettings,
    queue: VecDeque<Fusion>,
    job: Option<Job>,
    worker: Option<rayon::ThreadPool>,
    done: usize,
}

/// A fusion under way.
#[derive(Debug)]
struct Job {
    fusion: Fusion,
    source: Arc<Submap>,
    t_target_source: Pose,
    /// Scans until the first merge.
    scans_left: usize,
    parts: Receiver<Part>,
    /// Parts taken so far, and whether that is all.
    taken: usize,
    is_last: bool,
    /// The last part taken.
    merge: Merge,
}

/// What the thread sends.
#[derive(Debug)]
struct Part {
    resampled: Resampled,
    is_last: bool,
}

impl Job {
    /// Merges the next `blocks` blocks; returns whether all are merged.
    fn merge(&mut self, target: &mut Submap, mut blocks: usize, settings: &FusionSettings) -> bool {
        loop {
            let now = blocks.min(self.merge.left());
            self.merge.step(target, now);
            blocks -= now;
            if self.merge.left() == 0 && self.is_last {
                return true;
            }
            if blocks == 0 {
                return false;
            }
            let Part { resampled, is_last } = self.take(settings);
            (self.merge, self.is_last) = (Merge::new(resampled, *settings), is_last);
            self.taken += 1;
        }
    }

    /// The next part.
    fn take(&self, settings: &FusionSettings) -> Part {
        // Where the system gave no thread, or it is gone, nothing comes: parts are sampled here, each from the beginning, which is slow but the same.
        self.parts.recv().unwrap_or_else(|_| {
            let sampling = Sampling::new(&self.source, &self.t_target_source, settings);
            let resampled = if self.taken < sampling.parts() { sampling.part(self.taken) } else { Resampled::default() };
            Part { resampled, is_last: self.taken + 1 >= sampling.parts() }
        })
    }
}

impl Fusing {
    pub fn new(settings: FusionSettings) -> Self {
        Self { settings, queue: VecDeque::new(), job: None, worker: None, done: 0 }
    }

    /// Fusions done.
    pub fn done(&self) -> usize {
        self.done
    }

    /// Fusions under way or waiting.
    pub fn due(&self) -> usize {
        self.queue.len() + usize::from(self.job.is_some())
    }

    /// Queues fusions. They are done in order: a target may be the source of a later one.
    pub fn ask(&mut self, fusions: impl IntoIterator<Item = Fusion>) {
        self.queue.extend(fusions);
    }

    /// Goes on by one scan.
    pub fn advance(&mut self, atlas: &mut Atlas, graph: &PoseGraph) {
        let Some(mut job) = self.job.take() else {
            self.job = self.begin(atlas, graph);
            return;
        };
        if job.scans_left > 0 {
            job.scans_left -= 1;
            self.job = Some(job);
            return;
        }
        let Some(target) = atlas.submap_mut(job.fusion.target) else {
            atlas.forget_retiring();
            return;
        };
        if job.merge(target, MERGED_PER_SCAN, &self.settings) {
            move_scans(target, &job.source, &job.t_target_source);
            atlas.forget_retiring();
            self.done += 1;
        } else {
            self.job = Some(job);
        }
    }

    /// Does everything that is due, with all threads of the caller's pool.
    pub fn finish(&mut self, atlas: &mut Atlas, graph: &PoseGraph) {
        if let Some(Job { fusion, source, t_target_source, taken, mut merge, parts, .. }) = self.job.take() {
            // The thread stops at its next part.
            drop(parts);
            if let Some(target) = atlas.submap_mut(fusion.target) {
                merge.step(target, usize::MAX);
            }
            self.complete(atlas, fusion, taken, &source, &t_target_source);
        }
        while let Some(fusion) = self.queue.pop_front() {
            if let Some((source, t_target_source)) = retire(fusion, atlas, graph) {
                self.complete(atlas, fusion, 0, &source, &t_target_source);
            }
        }
    }

    /// Does all of a fusion but the parts before the one numbered `first`.
    fn complete(&mut self, atlas: &mut Atlas, fusion: Fusion, first: usize, source: &Submap, t_target_source: &Pose) {
        if let Some(target) = atlas.submap_mut(fusion.target) {
            fuse_from(first, target, source, t_target_source, &self.settings);
            self.done += 1;
        }
        atlas.forget_retiring();
    }

    /// Starts the next fusion of the queue, unless its source has yet to come to rest: what is awake then would stay so until the end.
    fn begin(&mut self, atlas: &mut Atlas, graph: &PoseGraph) -> Option<Job> {
        let is_ready = |fusion: &mut Fusion| atlas.submap(fusion.source).is_none_or(|source| source.tsdf.is_at_rest());
        let fusion = self.queue.pop_front_if(is_ready)?;
        let (source, t_target_source) = retire(fusion, atlas, graph)?;
        let (sender, parts) = sync_channel(AHEAD);
        if self.worker.is_none() {
            let builder = rayon::ThreadPoolBuilder::new().num_threads(1).thread_name(|_| "fusion".to_owned()).start_handler(|_| give_way());
            // Without a thread of its own, the fusion is sampled when it is due.
            self.worker = builder.build().ok();
        }
        if let Some(worker) = &self.worker {
            let (source, settings) = (Arc::clone(&source), self.settings);
            worker.spawn(move || {
                let sampling = Sampling::new(&source, &t_target_source, &settings);
                let parts = sampling.parts();
                for number in 0..parts {
                    let part = Part { resampled: sampling.part(number), is_last: number + 1 == parts };
                    if sender.send(part).is_err() {
                        // The fusion was finished otherwise, or the mapper is gone.
                        break;
                    }
                }
            });
        }
        let merge = Merge::new(Resampled::default(), self.settings);
        Some(Job { fusion, source, t_target_source, scans_left: HEAD_START, parts, taken: 0, is_last: false, merge })
    }
}

/// Gives the calling thread what time others leave: a scan that has to share a core with it would take twice as long. Where the system
/// refuses, it goes on as before.
fn give_way() {
    #[cfg(target_os = "linux")]
    let _ = rustix::process::nice(19);
}

/// Takes the source out of the atlas; none if one of the submaps is not there.
fn retire(fusion: Fusion, atlas: &mut Atlas, graph: &PoseGraph) -> Option<(Arc<Submap>, Pose)> {
    let root = |atlas: &Atlas, id| atlas.submap(id).and_then(Submap::root_node).and_then(|node| graph.pose(node)).copied();
    let t_target_source = root(atlas, fusion.target)?.inv_mul(&root(atlas, fusion.source)?);
    let source = atlas.retire(fusion.source, fusion.target, t_target_source)?;
    Some((source, t_target_source))
}
