//! Fusions beside integration (paper Sec. IV-C): sampled by a thread of their own, merged in small steps between scans.
//!
//! A loop closure must not stall integration, and the map must not depend on timing. So what happens when is counted in scans: a fusion
//! begins after the scan that finds it first in the queue, its samples are taken over a number of scans later that follows from the
//! source's size (and are waited for if they are not there yet), and from then on every scan merges a fixed number of blocks.

use crate::atlas::cluster::Fusion;
use crate::atlas::fusion::{FusionSettings, Merge, Resampled, move_scans};
use crate::atlas::graph::PoseGraph;
use crate::atlas::{Atlas, Submap};
use crate::geometry::Pose;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};

/// Blocks of the source sampled while one scan is integrated, at least: a fusion waits for one scan per so many. Waiting longer than the
/// sampling takes costs memory for a while; waiting less would stall integration.
const SAMPLED_PER_SCAN: usize = 128;
/// Blocks merged after each scan: a few milliseconds, a fraction of what a scan takes. Four times as many made the slowest hundredth of
/// the scans beside fusions take twice the median.
const MERGED_PER_SCAN: usize = 512;

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
    stage: Stage,
}

#[derive(Debug)]
enum Stage {
    /// Samples come through the channel; they are taken after so many more scans.
    Sampling {
        samples: Receiver<Resampled>,
        scans_left: usize,
    },
    Merging(Box<Merge>),
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
        match self.job.take() {
            None => self.job = self.begin(atlas, graph),
            Some(mut job) => match job.stage {
                Stage::Sampling { samples, scans_left } if scans_left > 0 => {
                    self.job = Some(Job { stage: Stage::Sampling { samples, scans_left: scans_left - 1 }, ..job });
                }
                Stage::Sampling { samples, .. } => {
                    let resampled = self.receive(&samples, &job.source, &job.t_target_source);
                    job.stage = Stage::Merging(Box::new(Merge::new(resampled, self.settings)));
                    self.merge(job, atlas, MERGED_PER_SCAN);
                }
                Stage::Merging(_) => self.merge(job, atlas, MERGED_PER_SCAN),
            },
        }
    }

    /// Does everything that is due, with all threads of the caller's pool.
    pub fn finish(&mut self, atlas: &mut Atlas, graph: &PoseGraph) {
        loop {
            match self.job.take() {
                Some(Job { stage: Stage::Sampling { samples, .. }, fusion, source, t_target_source }) => {
                    let resampled = self.receive(&samples, &source, &t_target_source);
                    let stage = Stage::Merging(Box::new(Merge::new(resampled, self.settings)));
                    self.merge(Job { stage, fusion, source, t_target_source }, atlas, usize::MAX);
                }
                Some(job) => self.merge(job, atlas, usize::MAX),
                None => {
                    let Some(fusion) = self.queue.pop_front() else { return };
                    let Some((source, t_target_source)) = retire(fusion, atlas, graph) else { continue };
                    let resampled = Resampled::new(&source, &t_target_source, &self.settings);
                    let stage = Stage::Merging(Box::new(Merge::new(resampled, self.settings)));
                    self.merge(Job { stage, fusion, source, t_target_source }, atlas, usize::MAX);
                }
            }
        }
    }

    /// Starts the next fusion of the queue.
    fn begin(&mut self, atlas: &mut Atlas, graph: &PoseGraph) -> Option<Job> {
        let fusion = self.queue.pop_front()?;
        let (source, t_target_source) = retire(fusion, atlas, graph)?;
        let (sender, samples) = sync_channel(1);
        if self.worker.is_none() {
            let builder = rayon::ThreadPoolBuilder::new().num_threads(1).thread_name(|_| "fusion".to_owned()).start_handler(|_| give_way());
            // Without a thread of its own, the fusion is sampled when it is due.
            self.worker = builder.build().ok();
        }
        if let Some(worker) = &self.worker {
            let (source, settings) = (Arc::clone(&source), self.settings);
            worker.spawn(move || {
                let resampled = Resampled::new(&source, &t_target_source, &settings);
                drop(source);
                // Nobody listens any more when the mapper is gone.
                let _ = sender.send(resampled);
            });
        }
        let blocks = source.tsdf.len() + source.occupancy.len();
        let scans_left = blocks / SAMPLED_PER_SCAN;
        Some(Job { fusion, source, t_target_source, stage: Stage::Sampling { samples, scans_left } })
    }

    fn receive(&self, samples: &Receiver<Resampled>, source: &Submap, t_target_source: &Pose) -> Resampled {
        samples.recv().unwrap_or_else(|_| Resampled::new(source, t_target_source, &self.settings))
    }

    fn merge(&mut self, mut job: Job, atlas: &mut Atlas, blocks: usize) {
        let Some(target) = atlas.submap_mut(job.fusion.target) else {
            atlas.forget_retiring();
            return;
        };
        let is_done = match &mut job.stage {
            Stage::Merging(merge) => merge.step(target, blocks),
            Stage::Sampling { .. } => false,
        };
        if is_done {
            move_scans(target, &job.source, &job.t_target_source);
            atlas.forget_retiring();
            self.done += 1;
        } else {
            self.job = Some(job);
        }
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
