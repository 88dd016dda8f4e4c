//! While scans come with poses: whether these belong to them, now and then, beside the mapping.

use crate::source::pose_problem;
use crate::warning::{Code, Warnings};
use std::mem;
use std::thread::JoinHandle;
use voxelastic::Pose;
use voxelastic::event::Scan;
use voxelastic_slam::pose_check::{CheckScan, PoseCheck, Verdict, check, is_apart};

/// Pairs of scans that are compared at once.
const PAIRS: usize = 8;
/// Scans between two pairs, once the first were compared.
const PAUSE: usize = 50;
/// The two scans of a pair are at most so many apart.
const MOST_APART: usize = 10;

/// Compares poses with scans on a thread of its own. What it finds is a warning; the map does not depend on it.
#[derive(Default)]
pub struct PoseWatch {
    track: Vec<(f64, Pose)>,
    pairs: Vec<(CheckScan, CheckScan)>,
    first: Option<CheckScan>,
    pause: usize,
    has_compared: bool,
    comparing: Option<JoinHandle<PoseCheck>>,
    /// Whether the last comparison was told as a disagreement.
    is_told: bool,
}

impl PoseWatch {
    /// Looks at a scan with the pose that it came with.
    pub fn take(&mut self, scan: &Scan, warnings: &mut Warnings) {
        if self.comparing.as_ref().is_some_and(JoinHandle::is_finished) {
            self.finish(warnings);
        }
        if self.comparing.is_some() {
            return;
        }
        if self.pause > 0 {
            self.pause -= 1;
            return;
        }
        let index = self.track.len();
        self.track.push((scan.time, scan.t_map_lidar));
        let Some(first) = &self.first else {
            self.first = Some(CheckScan::new(index, &scan.cloud));
            return;
        };
        if index - first.index() < MOST_APART && !is_apart(&self.track[first.index()].1, &scan.t_map_lidar) {
            return;
        }
        let second = CheckScan::new(index, &scan.cloud);
        // At first, scans follow each other, so that a shift of rows or clocks shows.
        let next = (!self.has_compared).then(|| second.clone());
        self.pairs.extend(mem::replace(&mut self.first, next).map(|first| (first, second)));
        self.pause = if self.has_compared { PAUSE } else { 0 };
        if self.pairs.len() == PAIRS {
            let (track, pairs) = (mem::take(&mut self.track), mem::take(&mut self.pairs));
            (self.first, self.has_compared) = (None, true);
            let compare = move || check(&track, true, None, &pairs);
            self.comparing = std::thread::Builder::new().name("voxelastic-poses".to_owned()).spawn(compare).ok();
        }
    }

    /// Waits for a comparison that is under way, and says what it found.
    pub fn finish(&mut self, warnings: &mut Warnings) {
        let Some(Ok(found)) = self.comparing.take().map(JoinHandle::join) else { return };
        let is_wrong = matches!(found.verdict, Verdict::Disagree(_));
        if is_wrong && !self.is_told {
            warnings.add(Code::PosesDisagree, pose_problem(&found), "correct them where they come from, or let them be estimated");
        }
        self.is_told = is_wrong;
    }
}
