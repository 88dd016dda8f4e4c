//! Submaps follow corrections while a run goes on: those whose scans were moved relative to each other are rebuilt from kept scans, a scan at a time.

use super::{MappingRun, Observer};
use crate::error::one_line;
use crate::kept_scans::KeptScans;
use crate::warning::Code;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};
use voxelastic::atlas::SubmapId;
use voxelastic::event::Event;
use voxelastic::mapper::{RebuildError, Rebuilding};

/// While scans wait, rebuilding takes at most this share of the time.
const SHARE: f64 = 0.5;

/// Scans, and what is rebuilt from them.
pub(super) struct Following {
    scans: KeptScans,
    /// Whether poses were corrected since it was looked which submaps they have bent.
    is_stale: bool,
    current: Option<Rebuilding>,
    bent: Bent,
    /// Submaps that could not be rebuilt, with as many scans.
    given_up: BTreeMap<SubmapId, usize>,
    /// The last step, and how long it took.
    last: Option<(Instant, Duration)>,
    has_failed: bool,
}

/// Submaps whose scans corrections have moved relative to each other: what the map shows of them is not where it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Bent {
    /// Those that are being rebuilt, or wait for that.
    pub waiting: usize,
    /// Those that stay as they are, because their scans are not kept.
    pub for_good: usize,
}

impl Following {
    fn is_due(&self, scans_wait: bool) -> bool {
        !scans_wait || self.last.is_none_or(|(at, took)| at.elapsed() >= took.div_f64(SHARE))
    }
}

impl MappingRun {
    /// Keeps the scans that come, at most about `most_bytes` of them, in files without names in `folder`: what corrections bend can then be rebuilt by
    /// [`follow`](Self::follow) while the run goes on.
    pub fn keep_scans(&mut self, folder: &Path, most_bytes: u64) {
        self.following = Some(Following {
            scans: KeptScans::new(folder, most_bytes),
            is_stale: false,
            current: None,
            bent: Bent::default(),
            given_up: BTreeMap::new(),
            last: None,
            has_failed: false,
        });
    }

    /// What corrections have bent, as far as it was looked.
    pub fn bent(&self) -> Bent {
        self.following.as_ref().map_or_else(Bent::default, |following| following.bent)
    }

    /// Whether there is something to [`follow`](Self::follow).
    pub fn is_following(&self) -> bool {
        self.following.as_ref().is_some_and(|following| following.is_stale || following.current.is_some())
    }

    /// Keeps a scan, and notes corrections, before the mapper takes the event.
    pub(super) fn note_for_following(&mut self, event: &Event) {
        let Some(following) = &mut self.following else { return };
        match event {
            Event::Scan(scan) => {
                if let Err(problem) = following.scans.add(scan.node, &scan.cloud)
                    && !std::mem::replace(&mut following.has_failed, true)
                {
                    let text = format!("scans are not kept: {}", one_line(&problem));
                    self.warnings.add(Code::NotRebuilt, text, "what corrections bend stays bent; make room on the disk, and record the topics");
                }
            }
            Event::PoseUpdate(_) => following.is_stale = true,
            _ => {}
        }
    }

    /// Forgets the scans, as another map begins.
    pub(super) fn stop_following(&mut self) {
        if let Some(following) = &mut self.following {
            following.scans.clear();
            (following.is_stale, following.current, following.bent) = (false, None, Bent::default());
            following.given_up.clear();
        }
    }

    /// Integrates one scan again into a submap that corrections have bent, if there is one; while `scans_wait`, only now and then. Says so once a submap is as the poses have it.
    pub fn follow(&mut self, scans_wait: bool, observer: &mut dyn Observer) {
        let Some(mut following) = self.following.take() else { return };
        if following.is_due(scans_wait) {
            let begin = Instant::now();
            let is_rebuilt = self.step(&mut following);
            following.last = Some((Instant::now(), begin.elapsed()));
            self.following = Some(following);
            if is_rebuilt {
                observer.rebuilt(&self.moment());
            }
        } else {
            self.following = Some(following);
        }
    }

    fn step(&mut self, following: &mut Following) -> bool {
        if following.current.is_none() {
            if !std::mem::take(&mut following.is_stale) {
                return false;
            }
            self.choose(following);
        }
        let Some(current) = &mut following.current else { return false };
        let id = current.submap();
        match self.mapping.step_rebuild(current, &mut following.scans) {
            Ok(None) => return false,
            Ok(Some(report)) => {
                tracing::info!("submap {id} follows the corrected poses: rebuilt from {} scans", report.scans);
                (following.current, following.is_stale) = (None, true);
                following.bent.waiting = following.bent.waiting.saturating_sub(1);
                if following.bent.waiting > 0 {
                    return true;
                }
                // What was corrected meanwhile is looked for at once, so that nobody hears that all is well before.
                following.is_stale = false;
                self.choose(following);
                return true;
            }
            Err(RebuildError::Fused { .. } | RebuildError::NoSuchSubmap { .. }) => {}
            Err(error) => {
                let scans = self.mapping.atlas().submap(id).map_or(0, |submap| submap.scans().len());
                following.given_up.insert(id, scans);
                self.warnings.add(Code::NotRebuilt, format!("submap {id} is not rebuilt: {}", one_line(&error)), "");
            }
        }
        (following.current, following.is_stale) = (None, true);
        false
    }

    /// Begins with the bent submap that was entered last: the robot is there.
    fn choose(&mut self, following: &mut Following) {
        let (atlas, mapper) = (self.mapping.atlas(), self.mapping.mapper());
        let deformed = mapper.deformed();
        let can_be = |id: SubmapId| {
            let scans = atlas.submap(id).map(|submap| submap.scans()).unwrap_or_default();
            following.given_up.get(&id) != Some(&scans.len()) && scans.iter().all(|scan| following.scans.has(scan.node))
        };
        let (possible, others): (Vec<SubmapId>, Vec<SubmapId>) = deformed.iter().map(|bent| bent.submap).partition(|&id| can_be(id));
        let entered = |id: &SubmapId| atlas.submap(*id).and_then(|submap| submap.scans().last()).map(|scan| scan.node);
        let next = possible.iter().copied().max_by_key(entered);
        following.bent = Bent { waiting: possible.len(), for_good: others.len() };
        following.current = next.and_then(|id| mapper.begin_rebuild(id).ok());
        let most = deformed.iter().map(|bent| bent.distance).fold(0.0, f64::max);
        if next.is_some() {
            tracing::info!("corrections moved scans of {} submaps relative to each other, by up to {most:.2} m: they are rebuilt", deformed.len());
        }
        if !others.is_empty() {
            let text = format!("corrections have bent {} submaps whose scans are not kept: their walls stay where they were", others.len());
            self.warnings.add_repeated(Code::NotRebuilt, text, "keep more scans (--keep-scans), or begin a new map with the service reset");
        }
    }
}
