//! Finds points on what moves, and removes what it left.

use super::view::{Scratch, Sight, View};
use super::votes::Votes;
use crate::atlas::{Submap, SubmapId};
use crate::event::NodeId;
use crate::geometry::{Pose, PoseExt, Rigid};
use crate::sensor::{BeamModel, PROJECT_CHUNK, RangeImage, Returns};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::cell::RefCell;

/// A scan is kept as a view if it was taken this far from the last one, metres and radians, or this many scans later.
const APART: f64 = 0.4;
const TURNED: f64 = 0.1;
const LATER: usize = 5;
/// Most views; then every second one is dropped, except for the last ones.
const MOST_VIEWS: usize = 24;
const LAST_VIEWS: usize = 8;
/// One of so many returns is judged first; the others only beside those that move.
const STRIDE: usize = 3;
/// What moves grows over returns of which so many neighbours in the image, at most two pixels and this far away in range, move; so many times.
const LEAST_BESIDE: u8 = 3;
const BESIDE: f32 = 0.4;
const GROWTH: usize = 3;
/// Ages of the views with which a scan is compared, counted in views.
const AGES: [usize; 6] = [1, 2, 3, 5, 9, 17];

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::new(Scratch::default());
}

/// Finds points on what moves.
#[derive(Debug, Default)]
pub(in crate::mapper) struct MovingDetector {
    /// The submap that scans are integrated into, and what they saw in it, in order.
    submap: Option<SubmapId>,
    views: Vec<View>,
    /// Scans since the last view.
    scans: usize,
}

/// The views of a [`MovingDetector`], to make them again from their scans.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(in crate::mapper) struct MovingState {
    submap: Option<SubmapId>,
    views: Vec<StoredView>,
    scans: usize,
}

/// The scan of a view.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct StoredView {
    node: NodeId,
    #[serde(with = "crate::geometry::stored")]
    t_submap_lidar: Pose,
}

impl MovingDetector {
    /// The submap that scans were integrated into last.
    pub fn submap(&self) -> Option<SubmapId> {
        self.submap
    }

    /// The next scan is integrated into `submap`, whose pose in the one before is known as `t_new_old`: the last views are taken along. Otherwise all are
    /// forgotten.
    pub fn enter(&mut self, submap: SubmapId, t_new_old: Option<&Pose>) {
        self.submap = Some(submap);
        let views = std::mem::take(&mut self.views);
        if let Some(t_new_old) = t_new_old {
            let first = views.len().saturating_sub(AGES[AGES.len() - 1]);
            self.views.extend(views.into_iter().skip(first).map(|view| view.moved(t_new_old)));
        }
    }

    /// Which returns are on something that moves, by the views before; empty if none is.
    pub fn judge(&self, t_submap_lidar: &Pose, returns: &Returns, image: &RangeImage, model: &BeamModel) -> Vec<bool> {
        let views: Vec<&View> = AGES.iter().rev().filter_map(|age| self.views.len().checked_sub(*age)).map(|i| &self.views[i]).collect();
        let count = returns.points.len();
        if views.is_empty() || count == 0 {
            return Vec::new();
        }
        let pose = Rigid::from(t_submap_lidar);
        let votes = |which: &[usize]| votes_of(&views, model, which.len(), |i| pose.apply(returns.points[which[i]]));
        let judge = |which: &[usize]| -> Vec<bool> { votes(which).iter().map(Votes::has_come).collect() };
        let sparse: Vec<usize> = (0..count).step_by(STRIDE).collect();
        let mut moves = vec![false; count];
        let mut beside = vec![false; count];
        let mut any = false;
        for (&i, _) in sparse.iter().zip(judge(&sparse)).filter(|(_, comes)| *comes) {
            any = true;
            beside[i.saturating_sub(STRIDE)..(i + STRIDE + 1).min(count)].fill(true);
        }
        if !any {
            return Vec::new();
        }
        let dense: Vec<usize> = (0..count).filter(|&i| beside[i]).collect();
        for (&i, comes) in dense.iter().zip(judge(&dense)) {
            moves[i] = comes;
        }
        grow(&mut moves, returns, image, |which| votes(which).iter().map(Votes::may_join).collect());
        moves
    }

    /// Keeps what a scan saw, if it is apart from the last one kept.
    pub fn remember(&mut self, node: NodeId, t_submap_lidar: &Pose, image: &RangeImage, model: &BeamModel) {
        self.scans += 1;
        let is_apart = self.views.last().is_none_or(|last| {
            let (a, b) = (&last.t_submap_lidar, t_submap_lidar);
            a.translation_distance(b) >= APART || a.rotation_distance(b) >= TURNED || self.scans >= LATER
        });
        if !is_apart {
            return;
        }
        if self.views.len() == MOST_VIEWS {
            let mut i = 0;
            self.views.retain(|_| {
                i += 1;
                i % 2 == 1 || i > MOST_VIEWS - LAST_VIEWS
            });
        }
        self.views.push(View::new(node, t_submap_lidar, image, model));
        self.scans = 0;
    }

    /// Removes surfaces of `submap`, whose views these are, from places that are void in most of them or in the last ones. Returns the number of voxels removed.
    pub fn clean(&self, submap: &mut Submap, model: &BeamModel) -> usize {
        if self.views.len() < 3 || self.submap != Some(submap.id) {
            return 0;
        }
        let views: Vec<&View> = self.views.iter().collect();
        let voxel = submap.voxel_size as f32;
        let is_gone = |centres: &[[f32; 3]]| -> Vec<bool> {
            let votes = votes_of_few(&views, model, centres.iter().map(|c| c.map(|c| c * voxel)).collect());
            votes.iter().map(Votes::has_gone).collect()
        };
        submap.tsdf.remove_voxels(&is_gone)
    }

    /// What is needed to go on later.
    pub fn state(&self) -> MovingState {
        let of_view = |view: &View| StoredView { node: view.node, t_submap_lidar: view.t_submap_lidar };
        MovingState { submap: self.submap, views: self.views.iter().map(of_view).collect(), scans: self.scans }
    }
}

impl MovingState {
    /// The nodes of its views, each with its pose in the submap.
    pub fn views(&self) -> impl Iterator<Item = (NodeId, Pose)> + '_ {
        self.views.iter().map(|view| (view.node, view.t_submap_lidar))
    }

    /// A detector without its views, which are to be [added](MovingDetector::add_view).
    pub fn detector(&self) -> MovingDetector {
        MovingDetector { submap: self.submap, views: Vec::new(), scans: self.scans }
    }
}

impl MovingDetector {
    /// Adds a view of a state.
    pub fn add_view(&mut self, node: NodeId, t_submap_lidar: &Pose, image: &RangeImage, model: &BeamModel) {
        self.views.push(View::new(node, t_submap_lidar, image, model));
    }
}

/// Adds to the returns that move those beside them that may join: lower parts near the ground, and parts of which the views know nothing.
fn grow(moves: &mut [bool], returns: &Returns, image: &RangeImage, may_join: impl Fn(&[usize]) -> Vec<bool>) {
    let (rows, columns) = (image.rows as isize, image.columns as isize);
    let mut at_pixel = vec![usize::MAX; image.ranges.len()];
    for (i, &pixel) in returns.pixel.iter().enumerate().take(returns.measured) {
        if let Some(at) = at_pixel.get_mut(pixel as usize) {
            *at = i;
        }
    }
    let mut beside = vec![0u8; moves.len()];
    let mut last: Vec<usize> = (0..returns.measured).filter(|&i| moves[i] && (returns.pixel[i] as usize) < at_pixel.len()).collect();
    for _ in 0..GROWTH {
        let mut candidates = Vec::new();
        for &i in &last {
            let (row, column) = (returns.pixel[i] as isize / columns, returns.pixel[i] as isize % columns);
            for r in (row - 2).max(0)..(row + 3).min(rows) {
                for c in column - 2..column + 3 {
                    let j = at_pixel[(r * columns + c.rem_euclid(columns)) as usize];
                    if j != usize::MAX && !moves[j] && (returns.ranges[j] - returns.ranges[i]).abs() < BESIDE {
                        beside[j] = beside[j].saturating_add(1);
                        if beside[j] == LEAST_BESIDE {
                            candidates.push(j);
                        }
                    }
                }
            }
        }
        let joins = may_join(&candidates);
        last = candidates.into_iter().zip(joins).filter(|(_, joins)| *joins).map(|(j, _)| j).collect();
        last.iter().for_each(|&j| moves[j] = true);
    }
}

/// What `views`, oldest first, tell of `count` places, submap frame, metres.
fn votes_of(views: &[&View], model: &BeamModel, count: usize, place: impl Fn(usize) -> [f32; 3] + Sync) -> Vec<Votes> {
    let mut votes = vec![Votes::default(); count];
    votes.par_chunks_mut(PROJECT_CHUNK).enumerate().for_each(|(chunk, votes)| {
        let first = chunk * PROJECT_CHUNK;
        let places = (first..first + votes.len()).map(&place).collect();
        votes.copy_from_slice(&votes_of_few(views, model, places));
    });
    votes
}

/// As [`votes_of`], on the calling thread.
fn votes_of_few(views: &[&View], model: &BeamModel, places: Vec<[f32; 3]>) -> Vec<Votes> {
    let mut votes = vec![Votes::default(); places.len()];
    SCRATCH.with_borrow_mut(|scratch| {
        for view in views {
            for (places, votes) in places.chunks(PROJECT_CHUNK).zip(votes.chunks_mut(PROJECT_CHUNK)) {
                view.look(model, places, scratch, |i, sight: Sight| votes[i].add(sight));
            }
        }
    });
    votes
}
