//! Fusions in the background (paper Sec. IV-C): sampled by a thread of their own, merged in small steps between scans.
//!
//! A loop closure must not delay integration, and the map must not depend on timing. So the schedule counts scans: a fusion begins after the
//! first scan at which it heads the queue and no scan has entered its source for a while; a fixed number of scans later each scan merges a fixed number of blocks.
//! A part that is not sampled by then is sampled by the scan (`background_sampling`).

use super::background_sampling::BackgroundSampling;
use crate::atlas::cluster::Fusion;
use crate::atlas::fusion::{FusionSettings, Merge, Resampled, fuse_from, move_scans};
use crate::atlas::graph::PoseGraph;
use crate::atlas::{Atlas, Submap, SubmapId};
use crate::geometry::Pose;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

/// Scans since the last one that entered the source of a fusion: it is compact by then, as a rule. What is not stays so until the fusion is done, which
/// takes memory only.
const SETTLED: u64 = 20;
/// Scans between the beginning of a fusion and its first merge, during which the thread determines which blocks the source reaches.
const SCANS_BEFORE_MERGE: usize = 8;
/// Blocks merged after each scan: this takes one or two milliseconds, and a thread with a quarter of a core samples as many. With eight times
/// as many, the slowest hundredth of the scans during fusions took twice the median.
const BLOCKS_PER_SCAN: usize = 256;

/// The queued fusions and the one in progress.
#[derive(Debug)]
pub(super) struct BackgroundFusion {
    settings: FusionSettings,
    active: Option<ActiveFusion>,
    worker: Option<rayon::ThreadPool>,
    schedule: FusionSchedule,
}

/// What the schedule of fusions depends on, while none is in progress.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct FusionSchedule {
    queue: VecDeque<Fusion>,
    /// Number of completed fusions.
    done: usize,
    /// Scans so far.
    scans: u64,
    /// The scan that entered each submap last.
    entered: BTreeMap<SubmapId, u64>,
}

/// The fusion in progress.
#[derive(Debug)]
struct ActiveFusion {
    fusion: Fusion,
    source: Arc<Submap>,
    t_target_source: Pose,
    /// Scans until the first merge.
    scans_left: usize,
    sampling: BackgroundSampling,
    /// Merge of the part taken last, and whether that was the last of all.
    merge: Merge,
    is_last: bool,
}

impl ActiveFusion {
    /// Merges the next `blocks` blocks; returns whether all are merged.
    fn merge(&mut self, target: &mut Submap, mut blocks: usize, settings: &FusionSettings) -> bool {
        loop {
            let now = blocks.min(self.merge.remaining());
            self.merge.step(target, now);
            blocks -= now;
            if self.merge.remaining() == 0 && self.is_last {
                return true;
            }
            if blocks == 0 {
                return false;
            }
            let (resampled, is_last) = self.sampling.next_part();
            (self.merge, self.is_last) = (Merge::new(resampled, *settings), is_last);
        }
    }
}

impl BackgroundFusion {
    pub fn new(settings: FusionSettings) -> Self {
        Self { settings, active: None, worker: None, schedule: FusionSchedule::default() }
    }

    /// The schedule; none while a fusion is in progress.
    pub fn schedule(&self) -> Option<&FusionSchedule> {
        self.active.is_none().then_some(&self.schedule)
    }

    /// Goes on with a schedule of an earlier process.
    pub fn set_schedule(&mut self, schedule: FusionSchedule) {
        self.schedule = schedule;
    }

    /// Number of completed fusions.
    pub fn done(&self) -> usize {
        self.schedule.done
    }

    /// Number of fusions in progress or queued.
    pub fn due(&self) -> usize {
        self.schedule.queue.len() + usize::from(self.active.is_some())
    }

    /// Queues fusions. They are done in order: a target may be the source of a later one.
    pub fn enqueue(&mut self, fusions: impl IntoIterator<Item = Fusion>) {
        self.schedule.queue.extend(fusions);
    }

    /// Does the work of one scan, which entered the submap `entered` if it was usable.
    pub fn step(&mut self, atlas: &mut Atlas, graph: &PoseGraph, entered: Option<SubmapId>) {
        self.schedule.scans += 1;
        self.schedule.entered.extend(entered.map(|id| (id, self.schedule.scans)));
        let Some(mut active) = self.active.take() else {
            self.active = self.begin(atlas, graph);
            return;
        };
        if active.scans_left > 0 {
            active.scans_left -= 1;
            self.active = Some(active);
            return;
        }
        let Some(target) = atlas.submap_mut(active.fusion.target) else {
            atlas.end_fusion();
            return;
        };
        if active.merge(target, BLOCKS_PER_SCAN, &self.settings) {
            move_scans(target, &active.source, &active.t_target_source);
            atlas.end_fusion();
            self.schedule.done += 1;
        } else {
            self.active = Some(active);
        }
    }

    /// Completes all fusions with all threads of the caller's pool.
    pub fn finish(&mut self, atlas: &mut Atlas, graph: &PoseGraph) {
        if let Some(ActiveFusion { fusion, source, t_target_source, sampling, mut merge, .. }) = self.active.take() {
            let taken = sampling.taken();
            // Ends the thread's work.
            drop(sampling);
            if let Some(target) = atlas.submap_mut(fusion.target) {
                merge.step(target, usize::MAX);
            }
            self.complete(atlas, fusion, taken, &source, &t_target_source);
        }
        while let Some(fusion) = self.schedule.queue.pop_front() {
            if let Some((source, t_target_source)) = take_source(fusion, atlas, graph) {
                self.complete(atlas, fusion, 0, &source, &t_target_source);
            }
        }
    }

    /// Completes a fusion of which the parts before part `first` are merged.
    fn complete(&mut self, atlas: &mut Atlas, fusion: Fusion, first: usize, source: &Submap, t_target_source: &Pose) {
        if let Some(target) = atlas.submap_mut(fusion.target) {
            fuse_from(first, target, source, t_target_source, &self.settings);
            self.schedule.done += 1;
        }
        atlas.end_fusion();
    }

    /// Begins the next fusion of the queue if its source has settled.
    fn begin(&mut self, atlas: &mut Atlas, graph: &PoseGraph) -> Option<ActiveFusion> {
        let FusionSchedule { queue, scans, entered, .. } = &mut self.schedule;
        let is_ready = |fusion: &mut Fusion| entered.get(&fusion.source).is_none_or(|last| *scans - last >= SETTLED);
        let fusion = queue.pop_front_if(is_ready)?;
        entered.remove(&fusion.source);
        let (source, t_target_source) = take_source(fusion, atlas, graph)?;
        if self.worker.is_none() {
            let builder = rayon::ThreadPoolBuilder::new().num_threads(1).thread_name(|_| "fusion".to_owned()).start_handler(|_| lower_priority());
            // Without a thread of its own, the fusion is sampled when it is merged.
            self.worker = builder.build().ok();
        }
        let sampling = BackgroundSampling::start(Arc::clone(&source), t_target_source, self.worker.as_ref());
        let merge = Merge::new(Resampled::default(), self.settings);
        Some(ActiveFusion { fusion, source, t_target_source, scans_left: SCANS_BEFORE_MERGE, sampling, merge, is_last: false })
    }
}

/// Gives the calling thread the lowest priority: a scan that shares a core with it would take twice as long otherwise. If the system
/// refuses, the priority stays as it is.
fn lower_priority() {
    #[cfg(target_os = "linux")]
    let _ = rustix::process::nice(19);
}

/// Removes the source of a fusion from the atlas; none if one of the submaps does not exist.
fn take_source(fusion: Fusion, atlas: &mut Atlas, graph: &PoseGraph) -> Option<(Arc<Submap>, Pose)> {
    let root = |atlas: &Atlas, id| atlas.submap(id).and_then(Submap::root_node).and_then(|node| graph.pose(node)).copied();
    let t_target_source = root(atlas, fusion.target)?.inv_mul(&root(atlas, fusion.source)?);
    let source = atlas.begin_fusion(fusion.source, fusion.target, t_target_source)?;
    Some((source, t_target_source))
}
