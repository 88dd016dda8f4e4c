//! A run whose map follows corrections while it goes on.

use super::following::Following;
use super::{Bent, MappingRun, Observer};
use std::path::Path;
use voxelastic::event::Event;

impl MappingRun {
    /// Keeps the scans that come, at most about `most_bytes` of them, in files without names in `folder`: what corrections bend can then be rebuilt by
    /// [`follow`](Self::follow) while the run goes on.
    pub fn keep_scans(&mut self, folder: &Path, most_bytes: u64) {
        self.following = Some(Following::new(folder, most_bytes));
    }

    /// What corrections have bent, as far as it was looked.
    pub fn bent(&self) -> Bent {
        self.following.as_ref().map_or_else(Bent::default, Following::bent)
    }

    /// Whether there is something to [`follow`](Self::follow).
    pub fn is_following(&self) -> bool {
        self.following.as_ref().is_some_and(Following::has_work)
    }

    /// Keeps a scan, and notes corrections, before the mapper takes the event.
    pub(super) fn note_for_following(&mut self, event: &Event) {
        self.following.iter_mut().for_each(|following| following.note(event, &mut self.warnings));
    }

    /// Integrates one scan again into a submap that corrections have bent, if there is one; while `scans_wait`, only now and then. Says so once a submap is as the poses have it.
    pub fn follow(&mut self, scans_wait: bool, observer: &mut dyn Observer) {
        let Some(following) = &mut self.following else { return };
        if following.follow(scans_wait, &mut self.mapping, &mut self.warnings) {
            observer.rebuilt(&self.moment());
        }
    }
}
