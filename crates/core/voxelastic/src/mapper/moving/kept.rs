//! Scans that are kept to the end, and the removal of what they show to be gone.
//!
//! A surface is judged by the scans of its submap and those just before and after, and by those of later times that saw its place again. Between the latter and
//! the surface lies a part of the graph that may be wrong, so they only tell with wide margins, and only if none of them saw anything there.

use super::cells::Cells;
use super::view::{Care, PlacedView, View};
use super::votes::{Places, Votes, votes_of_few};
use crate::atlas::graph::PoseGraph;
use crate::atlas::{Submap, SubmapId};
use crate::event::NodeId;
use crate::field::tsdf::RemoveFrom;
use crate::geometry::{Pose, PoseExt};
use crate::sensor::BeamModel;
use rayon::prelude::*;
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

/// A scan is kept if it was taken this far from the last one kept, metres, or this many scans later.
const KEPT_SPACING: f64 = 3.0;
const LATER: usize = 10;
/// Scans just before and after those of a submap that tell of its surfaces as well.
const SAME_TIME: usize = 5;
/// Most scans of the submap and of its time, and of later times, by which its surfaces are judged.
const MOST: usize = 24;
const MOST_LATER: usize = 12;
/// Thinner things may be missed between beams, metres.
const THIN: f32 = 0.12;
/// Later scans tell of a submap if they were taken this near to one of its scans, metres.
const IN_SIGHT: f64 = 30.0;

/// What a scan saw.
#[derive(Clone, Debug)]
struct KeptScan {
    node: NodeId,
    cells: Arc<Cells>,
    /// How far the poses of scans before were off as seen from it, metres.
    was_off: f32,
}

/// The kept scans, in order.
#[derive(Debug, Default)]
pub(super) struct KeptScans {
    scans: Vec<KeptScan>,
    last: Option<Pose>,
    /// Scans since the last one kept.
    since: usize,
    /// By submap, the scans in it and those that judged it when it was cleaned last.
    cleaned: BTreeMap<SubmapId, (usize, Vec<NodeId>)>,
}

impl KeptScans {
    /// Whether the next scan, at a pose in the map, is to be kept.
    pub fn wants(&mut self, t_map_lidar: &Pose) -> bool {
        self.since += 1;
        let wants = self.last.is_none_or(|last| last.translation_distance(t_map_lidar) >= KEPT_SPACING || self.since >= LATER);
        if wants {
            (self.last, self.since) = (Some(*t_map_lidar), 0);
        }
        wants
    }

    /// Keeps a scan.
    pub fn push(&mut self, node: NodeId, cells: Arc<Cells>, was_off: f32) {
        self.scans.push(KeptScan { node, cells, was_off });
    }

    /// The nodes of the kept scans.
    fn nodes(&self) -> impl Iterator<Item = NodeId> + '_ {
        self.scans.iter().map(|scan| scan.node)
    }

    /// The nodes of the kept scans, and how far off they were.
    pub fn stored(&self) -> Vec<(NodeId, f32)> {
        self.scans.iter().map(|scan| (scan.node, scan.was_off)).collect()
    }

    /// The last pose at which a scan was kept, and the scans since.
    pub fn place(&self) -> (Option<Pose>, usize) {
        (self.last, self.since)
    }

    /// Without scans, which are to be pushed again.
    pub fn at((last, since): (Option<Pose>, usize)) -> Self {
        Self { last, since, ..Self::default() }
    }

    /// The submap is made anew, and has to be cleaned again.
    pub fn forget(&mut self, submap: SubmapId) {
        self.cleaned.remove(&submap);
    }

    /// Removes surfaces of `submap` from places where nothing is before or after, as far as scans tell that `may_judge`. Returns the number of voxels removed.
    pub fn clean(&mut self, submap: &mut Submap, graph: &PoseGraph, model: &BeamModel, may_judge: &dyn Fn(NodeId) -> bool) -> usize {
        let chosen = self.choose(submap, graph, may_judge);
        let key = (submap.scans.len(), chosen.same_time.iter().chain(&chosen.later).map(|(i, _)| self.scans[*i].node).collect());
        if self.cleaned.get(&submap.id) == Some(&key) || chosen.same_time.len() + chosen.later.len() < 3 {
            return 0;
        }
        let views = |chosen: &[(usize, Pose)], care: Care| -> Vec<View> {
            let view = |(i, pose): &(usize, Pose)| View::new(self.scans[*i].node, pose, &self.scans[*i].cells, model, care);
            chosen.par_iter().map(view).collect()
        };
        let (near, far) = (views(&chosen.same_time, Care::NEAR), views(&chosen.later, Care::FAR));
        // Surfaces are where scans put them together, so that each scan is off by about as much as it was when it came.
        let (same_time, later) = (self.placed_views(&near, &chosen.same_time), self.placed_views(&far, &chosen.later));
        let voxel = submap.voxel_size;
        let is_gone = |centres: &[[f32; 3]]| -> Vec<bool> {
            let places: Vec<[f32; 3]> = centres.iter().map(|c| c.map(|c| c * voxel)).collect();
            let (count, places) = (places.len(), Places { place: |i: usize| places[i], size: |_| [THIN; 2] });
            let now = votes_of_few(&same_time, model, count, &places, Votes::cannot_have_gone);
            let then = votes_of_few(&later, model, count, &places, Votes::cannot_be_gone_later);
            now.iter().zip(&then).map(|(now, then)| Votes::has_gone(now) || Votes::is_gone_later(then)).collect()
        };
        let removed = submap.tsdf.remove_voxels(RemoveFrom::BlocksWithSurface, &is_gone);
        self.cleaned.insert(submap.id, key);
        removed
    }

    /// Views from their known poses, with what these were off.
    fn placed_views<'a>(&self, views: &'a [View], chosen: &[(usize, Pose)]) -> Vec<PlacedView<'a>> {
        views.iter().zip(chosen).map(|(view, (i, _))| PlacedView { slip: self.scans[*i].was_off, ..view.as_known() }).collect()
    }

    /// The kept scans that tell of a submap, as indices with their poses in it.
    fn choose(&self, submap: &Submap, graph: &PoseGraph, may_judge: &dyn Fn(NodeId) -> bool) -> Chosen {
        let poses: HashMap<NodeId, &Pose> = submap.scans.iter().map(|scan| (scan.node, &scan.t_submap_lidar)).collect();
        let own: Vec<(usize, &Pose)> = self.nodes().enumerate().filter_map(|(i, node)| Some((i, *poses.get(&node)?))).collect();
        let Some(&(last, _)) = own.last() else { return Chosen::default() };
        let (mut same_time, mut later) = (Vec::new(), Vec::new());
        for (i, node) in self.nodes().enumerate().filter(|(_, node)| may_judge(*node)) {
            // From the nearest scan of the submap on, poses follow the graph.
            let at = own.partition_point(|(j, _)| *j < i);
            let nearest = own[at.saturating_sub(1)..(at + 1).min(own.len())].iter().min_by_key(|(j, _)| j.abs_diff(i));
            let Some(&(j, t_submap_own)) = nearest else { continue };
            if i == j {
                same_time.push((i, *t_submap_own));
                continue;
            }
            let (Some(own_pose), Some(pose)) = (graph.pose(self.scans[j].node), graph.pose(node)) else { continue };
            if i.abs_diff(j) <= SAME_TIME {
                same_time.push((i, t_submap_own * own_pose.inv_mul(pose)));
            } else if i > last {
                let t_submap_lidar = submap.t_map_submap.inv_mul(pose);
                if own.iter().any(|(_, own)| own.translation_distance(&t_submap_lidar) <= IN_SIGHT) {
                    later.push((i, t_submap_lidar));
                }
            }
        }
        Chosen { same_time: thinned(same_time, MOST), later: thinned(later, MOST_LATER) }
    }
}

#[derive(Debug, Default)]
struct Chosen {
    same_time: Vec<(usize, Pose)>,
    later: Vec<(usize, Pose)>,
}

/// At most `most` of them, evenly, with the last one.
fn thinned<T: Copy>(all: Vec<T>, most: usize) -> Vec<T> {
    if all.len() <= most {
        return all;
    }
    (1..=most).map(|k| all[k * all.len() / most - 1]).collect()
}
