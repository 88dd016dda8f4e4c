//! The frontier of the whole map, clustered.

use crate::frontier::{BlockFrontier, SubmapFrontier};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use std::collections::BTreeMap;
use voxelastic::Pose;
use voxelastic::atlas::{Atlas, Submap, SubmapId};
use voxelastic::field::occupancy::State;
use voxelastic::octree::BLOCK_EDGE;
use voxelastic::query::AtlasQuery;
use voxelastic_plan::Point;

/// How the frontier is clustered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrontierSettings {
    /// Largest extent of a cluster along an axis, metres.
    pub max_extent: f64,
    /// Smallest area of a cluster, square metres.
    pub min_area: f64,
}

impl Default for FrontierSettings {
    fn default() -> Self {
        Self { max_extent: 5.0, min_area: 0.5 }
    }
}

/// A part of the frontier: where free space, connected, meets unknown space.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct FrontierCluster {
    /// Centre: the place on the frontier that is nearest to the mean, map frame, metres.
    pub centre: Point,
    /// Unit vector from free towards unknown space, the mean weighted by area; of any direction if that is zero.
    pub normal: Point,
    /// Area, square metres.
    pub area: f64,
    /// Lengths of the box around it along the axes of the map frame, metres.
    pub extent: [f64; 3],
}

/// A place on the frontier in the map frame.
#[derive(Clone, Copy, Debug)]
struct Place {
    position: Point,
    normal: Vector3<f64>,
    area: f64,
}

/// The frontier of an atlas, kept up while the map grows and bends.
#[derive(Clone, Debug, Default)]
pub struct Frontiers {
    settings: FrontierSettings,
    submaps: BTreeMap<SubmapId, SubmapFrontier>,
}

impl Frontiers {
    /// An empty frontier.
    pub fn new(settings: FrontierSettings) -> Self {
        Self { settings, submaps: BTreeMap::new() }
    }

    /// Brings the frontier of every submap up to date: only where voxels changed their state since the last update. Returns the number of blocks looked at.
    pub fn update(&mut self, atlas: &Atlas) -> usize {
        let all: Vec<&Submap> = placed(atlas).map(|(submap, _)| submap).collect();
        self.submaps.retain(|id, _| all.iter().any(|submap| submap.id() == *id));
        all.iter().map(|submap| self.submaps.entry(submap.id()).or_default().update(submap.occupancy())).sum()
    }

    /// The frontier of the map as it is now, in the box with the corners `bounds` (map frame, metres), largest clusters first. A part that another submap has
    /// observed, at the current poses, is left out. The frontier must be up to date; `map` is the query of `atlas`.
    pub fn clusters(&self, atlas: &Atlas, map: &AtlasQuery<'_>, bounds: [Point; 2]) -> Vec<FrontierCluster> {
        let edge = BLOCK_EDGE as f64 * map.voxel_size();
        let mut bins: BTreeMap<[i32; 3], Vec<Place>> = BTreeMap::new();
        for place in self.places(atlas, map, bounds) {
            bins.entry(place.position.map(|c| (c / edge).floor() as i32)).or_default().push(place);
        }
        let mut clusters = Vec::new();
        for places in connected(bins) {
            self.split(places, &mut clusters);
        }
        clusters.sort_by(|a, b| b.area.total_cmp(&a.area).then_with(|| a.centre.partial_cmp(&b.centre).unwrap_or(std::cmp::Ordering::Equal)));
        clusters
    }

    /// Everything on the frontier that is unknown to all submaps.
    fn places(&self, atlas: &Atlas, map: &AtlasQuery<'_>, [low, high]: [Point; 2]) -> Vec<Place> {
        let voxel = map.voxel_size();
        let is_shared = atlas.submaps().len() > 1 || atlas.merging().is_some();
        let mut places = Vec::new();
        for (submap, t_map_submap) in placed(atlas) {
            let Some(frontier) = self.submaps.get(&submap.id()) else { continue };
            let mut blocks: Vec<(&u64, &BlockFrontier)> = frontier.blocks.iter().collect();
            blocks.sort_unstable_by_key(|(key, _)| **key);
            let place = |(_, block): &(&u64, &BlockFrontier)| {
                let in_map = |p: [f32; 3]| -> Point { (t_map_submap * Point3::from(p.map(|c| f64::from(c) * voxel))).coords.into() };
                let position = in_map(block.position);
                let is_within = (0..3).all(|k| position[k] >= low[k] && position[k] <= high[k]);
                let is_unknown = || !is_shared || map.state(in_map(block.probe)) == State::Unknown;
                (is_within && is_unknown()).then(|| Place {
                    position,
                    normal: t_map_submap.rotation * Vector3::from(block.normal.map(f64::from)),
                    area: f64::from(block.faces) * voxel * voxel,
                })
            };
            places.extend(blocks.par_iter().with_min_len(256).filter_map(place).collect::<Vec<_>>());
        }
        places
    }

    /// Divides places along the longest axis until each part is small enough.
    fn split(&self, places: Vec<Place>, clusters: &mut Vec<FrontierCluster>) {
        let bound = |k: usize, pick: fn(f64, f64) -> f64| places.iter().map(|p| p.position[k]).reduce(pick).unwrap_or(0.0);
        let (low, high) = ([0, 1, 2].map(|k| bound(k, f64::min)), [0, 1, 2].map(|k| bound(k, f64::max)));
        let extent: [f64; 3] = std::array::from_fn(|k| high[k] - low[k]);
        let longest = (0..3).fold(0, |best, k| if extent[k] > extent[best] { k } else { best });
        if extent[longest] > self.settings.max_extent {
            let middle = 0.5 * (low[longest] + high[longest]);
            let (a, b): (Vec<Place>, Vec<Place>) = places.into_iter().partition(|p| p.position[longest] < middle);
            self.split(a, clusters);
            self.split(b, clusters);
            return;
        }
        let area: f64 = places.iter().map(|p| p.area).sum();
        if area < self.settings.min_area {
            return;
        }
        let mean: Point = std::array::from_fn(|k| places.iter().map(|p| p.position[k] * p.area).sum::<f64>() / area);
        let off = |p: &Place| voxelastic_plan::distance(p.position, mean);
        let Some(centre) = places.iter().min_by(|a, b| off(a).total_cmp(&off(b))) else { return };
        let normal = places.iter().map(|p| p.normal).sum::<Vector3<f64>>().try_normalize(1e-9).unwrap_or_else(Vector3::x);
        clusters.push(FrontierCluster { centre: centre.position, normal: normal.into(), area, extent });
    }
}

/// All submaps of an atlas and their poses, with the one that is being fused.
fn placed(atlas: &Atlas) -> impl Iterator<Item = (&Submap, Pose)> {
    let merging = atlas.merging().map(|merging| (merging.submap, merging.t_map_submap));
    atlas.submaps().iter().map(|submap| (submap, submap.t_map_submap())).chain(merging)
}

/// Joins neighbouring bins.
fn connected(mut bins: BTreeMap<[i32; 3], Vec<Place>>) -> Vec<Vec<Place>> {
    let mut components = Vec::new();
    let mut stack = Vec::new();
    while let Some((bin, places)) = bins.pop_first() {
        let mut component = places;
        stack.push(bin);
        while let Some(bin) = stack.pop() {
            for i in 0..27 {
                let next = [bin[0] + i % 3 - 1, bin[1] + i / 3 % 3 - 1, bin[2] + i / 9 - 1];
                if let Some(places) = bins.remove(&next) {
                    component.extend(places);
                    stack.push(next);
                }
            }
        }
        components.push(component);
    }
    components
}
