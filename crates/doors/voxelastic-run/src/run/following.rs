//! Submaps follow corrections while a run goes on: those whose scans were moved relative to each other are rebuilt from kept scans, a scan at a time.

use crate::error::one_line;
use crate::kept_scans::KeptScans;
use crate::mapping::Mapping;
use crate::warning::{Code, Warnings};
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
    /// Keeps at most about `most_bytes` of scans in files without names in `folder`.
    pub(super) fn new(folder: &Path, most_bytes: u64) -> Self {
        Self {
            scans: KeptScans::new(folder, most_bytes),
            is_stale: false,
            current: None,
            bent: Bent::default(),
            given_up: BTreeMap::new(),
            last: None,
            has_failed: false,
        }
    }

    /// What corrections have bent, as far as it was looked.
    pub(super) fn bent(&self) -> Bent {
        self.bent
    }

    /// Whether there is something to do.
    pub(super) fn has_work(&self) -> bool {
        self.is_stale || self.current.is_some()
    }

    /// Keeps a scan, and notes corrections, before the mapper takes the event.
    pub(super) fn note(&mut self, event: &Event, warnings: &mut Warnings) {
        match event {
            Event::Scan(scan) => {
                if let Err(problem) = self.scans.add(scan.node, &scan.cloud)
                    && !std::mem::replace(&mut self.has_failed, true)
                {
                    let text = format!("scans are not kept: {}", one_line(&problem));
                    warnings.add(Code::NotRebuilt, text, "what corrections bend stays bent; make room on the disk, and record the topics");
                }
            }
            Event::PoseUpdate(_) => self.is_stale = true,
            _ => {}
        }
    }

    /// Forgets the scans, as another map begins.
    pub(super) fn clear(&mut self) {
        self.scans.clear();
        (self.is_stale, self.current, self.bent) = (false, None, Bent::default());
        self.given_up.clear();
    }

    /// Integrates one scan again into a submap that corrections have bent, if there is one; while `scans_wait`, only now and then. Returns whether a submap is as the poses
    /// have it now.
    pub(super) fn follow(&mut self, scans_wait: bool, mapping: &mut Mapping, warnings: &mut Warnings) -> bool {
        let is_due = !scans_wait || self.last.is_none_or(|(at, took)| at.elapsed() >= took.div_f64(SHARE));
        if !is_due {
            return false;
        }
        let begin = Instant::now();
        let is_rebuilt = self.step(mapping, warnings);
        self.last = Some((Instant::now(), begin.elapsed()));
        is_rebuilt
    }

    fn step(&mut self, mapping: &mut Mapping, warnings: &mut Warnings) -> bool {
        if self.current.is_none() {
            if !std::mem::take(&mut self.is_stale) {
                return false;
            }
            self.choose(mapping, warnings);
        }
        let Some(current) = &mut self.current else { return false };
        let id = current.submap();
        match mapping.step_rebuild(current, &mut self.scans) {
            Ok(None) => return false,
            Ok(Some(report)) => {
                tracing::info!("submap {id} follows the corrected poses: rebuilt from {} scans", report.scans);
                (self.current, self.is_stale) = (None, true);
                self.bent.waiting = self.bent.waiting.saturating_sub(1);
                if self.bent.waiting > 0 {
                    return true;
                }
                // What was corrected meanwhile is looked for at once, so that nobody hears that all is well before.
                self.is_stale = false;
                self.choose(mapping, warnings);
                return true;
            }
            Err(RebuildError::Fused { .. } | RebuildError::NoSuchSubmap { .. }) => {}
            Err(error) => {
                let scans = mapping.atlas().submap(id).map_or(0, |submap| submap.scans().len());
                self.given_up.insert(id, scans);
                warnings.add(Code::NotRebuilt, format!("submap {id} is not rebuilt: {}", one_line(&error)), "");
            }
        }
        (self.current, self.is_stale) = (None, true);
        false
    }

    /// Begins with the bent submap that was entered last: the robot is there.
    fn choose(&mut self, mapping: &Mapping, warnings: &mut Warnings) {
        let (atlas, mapper) = (mapping.atlas(), mapping.mapper());
        let deformed = mapper.deformed();
        let can_be = |id: SubmapId| {
            let scans = atlas.submap(id).map(|submap| submap.scans()).unwrap_or_default();
            self.given_up.get(&id) != Some(&scans.len()) && scans.iter().all(|scan| self.scans.has(scan.node))
        };
        let (possible, others): (Vec<SubmapId>, Vec<SubmapId>) = deformed.iter().map(|bent| bent.submap).partition(|&id| can_be(id));
        let entered = |id: &SubmapId| atlas.submap(*id).and_then(|submap| submap.scans().last()).map(|scan| scan.node);
        let next = possible.iter().copied().max_by_key(entered);
        self.bent = Bent { waiting: possible.len(), for_good: others.len() };
        self.current = next.and_then(|id| mapper.begin_rebuild(id).ok());
        let most = deformed.iter().map(|bent| bent.distance).fold(0.0, f64::max);
        if next.is_some() {
            tracing::info!("corrections moved scans of {} submaps relative to each other, by up to {most:.2} m: they are rebuilt", deformed.len());
        }
        if !others.is_empty() {
            let text = format!("corrections have bent {} submaps whose scans are not kept: their walls stay where they were", others.len());
            warnings.add_repeated(Code::NotRebuilt, text, "keep more scans (--keep-scans), or begin a new map with the service reset");
        }
    }
}
