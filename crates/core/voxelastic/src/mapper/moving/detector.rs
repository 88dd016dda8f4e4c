//! Finds points on what moves, and removes what it left.

use super::align::aligned;
use super::cells::Cells;
use super::kept::KeptScans;
use super::view::{Care, PlacedView, View, extent};
use super::votes::{Places, Votes, votes_of};
use crate::atlas::graph::PoseGraph;
use crate::atlas::{Submap, SubmapId};
use crate::event::NodeId;
use crate::geometry::stored::StoredPose;
use crate::geometry::{Pose, PoseExt, Rigid};
use crate::sensor::{BeamModel, PreparedScan, RangeImage, Returns};
use hashbrown::HashSet;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// A scan is kept as a view if it was taken this far from the last one, metres and radians, or this many scans later.
const VIEW_SPACING: f64 = 0.4;
const TURNED: f64 = 0.1;
const LATER: usize = 5;
/// Of so many rows and columns, one return is judged first, by few views; those around it only if it moves.
const STRIDE: [usize; 2] = [2, 4];
/// What moves grows over returns of which so many neighbours in the image, at most two pixels and this far away in range, move; so many times.
const LEAST_NEIGHBOURS: u8 = 3;
const NEIGHBOUR_RANGE: f32 = 0.4;
const GROWTH: usize = 8;
/// It does not grow over an edge at which it stands on, or before, the plane of the neighbouring return: by more than this, metres, and this part of the distance.
const BEFORE: [f32; 2] = [0.03, 0.15];
/// Ages of the views with which a scan is compared, counted in views.
const AGES: [usize; 6] = [1, 2, 3, 5, 9, 17];
const FIRST_AGES: [usize; 3] = [3, 9, 17];
/// Views are aligned with so many returns of a scan, at most.
const ALIGNED_BY: usize = 2000;

/// Finds points on what moves.
#[derive(Debug, Default)]
pub(in crate::mapper) struct MovingDetector {
    /// The submap that scans are integrated into, and what they saw in it, in order.
    submap: Option<SubmapId>,
    views: Vec<View>,
    /// Scans since the last view.
    scans: usize,
    /// How far the pose of the oldest view was off as seen from the last scan, metres.
    was_off: f32,
    /// What is kept to the end.
    kept: KeptScans,
}

/// The views of a [`MovingDetector`], to make them again from their scans.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(in crate::mapper) struct MovingState {
    submap: Option<SubmapId>,
    views: Vec<StoredView>,
    scans: usize,
    kept: Vec<(NodeId, f32)>,
    was_off: f32,
    kept_last: Option<StoredPose>,
    kept_since: usize,
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
    pub fn judge(&mut self, t_submap_lidar: &Pose, scan: &PreparedScan, model: &BeamModel) -> Vec<bool> {
        let (moves, was_off) = self.moving_and_off(t_submap_lidar, scan, model);
        self.was_off = was_off;
        moves
    }

    /// Which returns are on something that moves, and how far the pose of the oldest view was off, metres.
    fn moving_and_off(&self, t_submap_lidar: &Pose, scan: &PreparedScan, model: &BeamModel) -> (Vec<bool>, f32) {
        let PreparedScan { image, returns, .. } = scan;
        if self.views.is_empty() || returns.measured == 0 {
            return (Vec::new(), 0.0);
        }
        let (rows, columns) = (image.rows, image.columns);
        let pose = Rigid::from(t_submap_lidar);
        let count = self.views.len();
        // Those that are too old for the first scans are replaced by the oldest.
        let within = |ages: &[usize]| -> Vec<usize> {
            let mut ages: Vec<usize> = ages.iter().rev().map(|&age| age.min(count)).collect();
            ages.dedup();
            ages
        };
        let all_ages = within(&AGES);
        let points: Vec<[f32; 3]> =
            returns.points[..returns.measured].iter().step_by(returns.measured / ALIGNED_BY + 1).map(|p| pose.apply(*p)).collect();
        let placed_views: Vec<PlacedView<'_>> = all_ages.par_iter().map(|age| aligned(&self.views[count - age], &points, model)).collect();
        let was_off = placed_views[0].was_off;
        let votes = |ages: &[usize], which: &[usize], settled: fn(&Votes, u16) -> bool| {
            let ages = within(ages);
            let placed_views: Vec<PlacedView<'_>> =
                all_ages.iter().zip(&placed_views).filter(|(age, _)| ages.contains(age)).map(|(_, placed_view)| *placed_view).collect();
            let size = |i: usize| {
                let pixel = returns.pixel[which[i]] as usize;
                if pixel < image.ranges.len() { extent(image, model, pixel) } else { [0.0; 2] }
            };
            votes_of(&placed_views, model, which.len(), &Places { place: |i| pose.apply(returns.points[which[i]]), size }, settled)
        };
        let in_pixels = |pixels: &[bool]| -> Vec<usize> {
            (0..returns.measured).filter(|&i| pixels.get(returns.pixel[i] as usize).is_some_and(|is_in| *is_in)).collect()
        };
        // In staggered rows.
        let mut is_first = vec![false; rows * columns];
        for (row, is_first) in is_first.chunks_exact_mut(columns).enumerate().step_by(STRIDE[0]) {
            is_first.iter_mut().skip(row / STRIDE[0] % 2 * STRIDE[1] / 2).step_by(STRIDE[1]).for_each(|is_first| *is_first = true);
        }
        let first = in_pixels(&is_first);
        let mut around = vec![false; rows * columns];
        let mut any = false;
        for (&i, _) in first.iter().zip(votes(&FIRST_AGES, &first, Votes::cannot_have_come)).filter(|(_, votes)| votes.has_come()) {
            any = true;
            let (row, column) = (returns.pixel[i] as usize / columns, returns.pixel[i] as usize % columns);
            for r in row.saturating_sub(STRIDE[0])..(row + STRIDE[0] + 1).min(rows) {
                (column + columns - STRIDE[1]..=column + columns + STRIDE[1]).for_each(|c| around[r * columns + c % columns] = true);
            }
        }
        if !any {
            return (Vec::new(), was_off);
        }
        let mut moves = vec![false; returns.len()];
        let dense = in_pixels(&around);
        for (&i, votes) in dense.iter().zip(votes(&AGES, &dense, Votes::cannot_have_come)) {
            moves[i] = votes.has_come();
        }
        grow(&mut moves, returns, image, |which| votes(&AGES, which, Votes::cannot_join).iter().map(Votes::may_join).collect());
        // Points between returns are as the return that they are nearest to.
        let sources: HashSet<u32> = (0..returns.measured).filter(|&i| moves[i]).map(|i| returns.source[i]).collect();
        (returns.measured..returns.len()).for_each(|i| moves[i] = sources.contains(&returns.source[i]));
        (moves, was_off)
    }

    /// Keeps what a scan saw, if it is apart from the last one kept.
    ///
    /// Scans whose surfaces are integrated at a pose in the map are kept to the end.
    pub fn remember(&mut self, node: NodeId, t_submap_lidar: &Pose, t_map_lidar: Option<&Pose>, scan: &PreparedScan, model: &BeamModel) {
        self.scans += 1;
        let is_apart = self.views.last().is_none_or(|last| {
            let (a, b) = (&last.t_submap_lidar, t_submap_lidar);
            a.translation_distance(b) >= VIEW_SPACING || a.rotation_distance(b) >= TURNED || self.scans >= LATER
        });
        let is_kept = t_map_lidar.is_some_and(|pose| self.kept.wants(pose));
        if !(is_apart || is_kept) {
            return;
        }
        let cells = Arc::new(Cells::new(scan));
        if is_apart {
            if self.views.len() == AGES[AGES.len() - 1] {
                self.views.remove(0);
            }
            self.views.push(View::new(node, t_submap_lidar, &cells, model, Care::NEAR));
            self.scans = 0;
        }
        if is_kept {
            self.kept.push(node, cells, self.was_off);
        }
    }

    /// Removes surfaces of `submap` from places where nothing is before or after. Returns the number of voxels removed.
    pub fn clean(&mut self, submap: &mut Submap, graph: &PoseGraph, model: &BeamModel, may_judge: &dyn Fn(NodeId) -> bool) -> usize {
        self.kept.clean(submap, graph, model, may_judge)
    }

    /// The submap is made anew, and has to be cleaned again.
    pub fn forget(&mut self, submap: SubmapId) {
        self.kept.forget(submap);
    }

    /// What is needed to go on later.
    pub fn state(&self) -> MovingState {
        let of_view = |view: &View| StoredView { node: view.node, t_submap_lidar: view.t_submap_lidar };
        let (kept_last, kept_since) = self.kept.place();
        MovingState {
            submap: self.submap,
            views: self.views.iter().map(of_view).collect(),
            scans: self.scans,
            kept: self.kept.stored(),
            was_off: self.was_off,
            kept_last: kept_last.map(StoredPose),
            kept_since,
        }
    }
}

impl MovingState {
    /// A detector in this state; `cells` reads the scan of a node again.
    ///
    /// # Errors
    /// Those of `cells`.
    pub fn detector<E>(&self, model: &BeamModel, mut cells: impl FnMut(NodeId) -> Result<Arc<Cells>, E>) -> Result<MovingDetector, E> {
        let (mut views, mut kept) = (Vec::new(), KeptScans::at((self.kept_last.map(|pose| pose.0), self.kept_since)));
        for view in &self.views {
            views.push(View::new(view.node, &view.t_submap_lidar, &cells(view.node)?, model, Care::NEAR));
        }
        for &(node, was_off) in &self.kept {
            kept.push(node, cells(node)?, was_off);
        }
        Ok(MovingDetector { submap: self.submap, views, scans: self.scans, was_off: self.was_off, kept })
    }
}

/// Adds to the returns that move their neighbours that may join: lower parts near the ground, and parts of which the views know nothing. Pieces of a thing
/// are convex where they meet, mostly; where it meets the ground that it stands on, or a wall behind it, is a hollow, and growth ends there.
fn grow(moves: &mut [bool], returns: &Returns, image: &RangeImage, may_join: impl Fn(&[usize]) -> Vec<bool>) {
    const NONE: u32 = u32::MAX;
    let (rows, columns) = (image.rows as isize, image.columns as isize);
    let mut at_pixel = vec![NONE; image.ranges.len()];
    for (i, &pixel) in (0u32..).zip(&returns.pixel[..returns.measured]) {
        if let Some(at) = at_pixel.get_mut(pixel as usize) {
            *at = i;
        }
    }
    let mut moving_neighbours = vec![0u8; moves.len()];
    let mut last: Vec<usize> = (0..returns.measured).filter(|&i| moves[i] && (returns.pixel[i] as usize) < at_pixel.len()).collect();
    for _ in 0..GROWTH {
        let mut candidates = Vec::new();
        for &i in &last {
            let (row, column) = (returns.pixel[i] as isize / columns, returns.pixel[i] as isize % columns);
            for r in (row - 2).max(0)..(row + 3).min(rows) {
                for c in column - 2..column + 3 {
                    let at = at_pixel[(r * columns + c.rem_euclid(columns)) as usize];
                    let j = at as usize;
                    if at != NONE && !moves[j] && (returns.ranges[j] - returns.ranges[i]).abs() < NEIGHBOUR_RANGE && !is_before(returns, i, j) {
                        moving_neighbours[j] = moving_neighbours[j].saturating_add(1);
                        if moving_neighbours[j] == LEAST_NEIGHBOURS {
                            candidates.push(j);
                        }
                    }
                }
            }
        }
        let joins = may_join(&candidates);
        last = candidates.into_iter().zip(joins).filter(|(_, joins)| *joins).map(|(j, _)| j).collect();
        if last.is_empty() {
            break;
        }
        last.iter().for_each(|&j| moves[j] = true);
    }
}

/// Whether return `i` is in front of the plane at return `j`, if there is one.
fn is_before(returns: &Returns, i: usize, j: usize) -> bool {
    let (p, q) = (returns.points[i], returns.points[j]);
    let way: [f32; 3] = std::array::from_fn(|k| p[k] - q[k]);
    let dot = |a: [f32; 3], b: [f32; 3]| (0..3).map(|k| a[k] * b[k]).sum::<f32>();
    returns.normals.get(j).is_some_and(|&normal| dot(way, normal) > BEFORE[0] + BEFORE[1] * dot(way, way).sqrt())
}
