//! The frontier of the whole map, clustered.

use crate::frontier::{BlockFrontier, Changes, SubmapFrontier};
use hashbrown::HashMap;
use nalgebra::{Point3, Vector3};
use std::collections::BTreeMap;
use voxelastic::Pose;
use voxelastic::atlas::{Atlas, Submap, SubmapId};
use voxelastic::field::occupancy::{OccupancyField, State};
use voxelastic::octree::{BLOCK_EDGE, BLOCK_SHIFT};
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
    /// Where the submaps were at the last update.
    poses: Vec<(SubmapId, Pose)>,
}

impl Frontiers {
    /// An empty frontier.
    pub fn new(settings: FrontierSettings) -> Self {
        Self { settings, submaps: BTreeMap::new(), poses: Vec::new() }
    }

    /// Brings the frontier of every submap up to date: only where voxels changed their state since the last update, or, after a correction of poses, what other submaps
    /// know of it. Returns the number of blocks looked at.
    pub fn update(&mut self, atlas: &Atlas) -> usize {
        let all: Vec<(&Submap, Pose)> = placed(atlas).collect();
        self.submaps.retain(|id, _| all.iter().any(|(submap, _)| submap.id() == *id));
        let (mut count, mut changes) = (0, Vec::with_capacity(all.len()));
        for (submap, _) in &all {
            let (looked_at, changed) = self.submaps.entry(submap.id()).or_default().update(submap.occupancy());
            count += looked_at;
            changes.push(changed);
        }
        let poses: Vec<(SubmapId, Pose)> = all.iter().map(|(submap, pose)| (submap.id(), *pose)).collect();
        let is_moved = poses != std::mem::replace(&mut self.poses, poses.clone());
        let voxel = f64::from(atlas.voxel_size());
        for (submap, t_map_submap) in &all {
            let Some(frontier) = self.submaps.get_mut(&submap.id()) else { continue };
            let others = all.iter().zip(&changes).filter(|((other, _), _)| other.id() != submap.id());
            let others: Vec<Other<'_>> = others
                .map(|((other, pose), changes)| Other { field: other.occupancy(), t_other_submap: pose.inverse() * t_map_submap, changes })
                .collect();
            let look_up = |block: &mut BlockFrontier| {
                let is_outdated = || {
                    others
                        .iter()
                        .any(|other| !other.changes.is_empty() && other.changes.has(other.voxel(block.probe, voxel).map(|c| c >> BLOCK_SHIFT)))
                };
                if is_moved || block.is_known_elsewhere.is_none() || is_outdated() {
                    block.is_known_elsewhere =
                        Some(others.iter().any(|other| other.field.state_at(other.voxel(block.probe, voxel)) != State::Unknown));
                }
            };
            frontier.blocks.values_mut().for_each(look_up);
        }
        count
    }

    /// The frontier of the map as it is now, in the box with the corners `bounds` (map frame, metres), largest clusters first. A part that another submap has
    /// observed, at the current poses, is left out. The frontier must be up to date; `map` is the query of `atlas`.
    pub fn clusters(&self, atlas: &Atlas, map: &AtlasQuery<'_>, bounds: [Point; 2]) -> Vec<FrontierCluster> {
        let edge = BLOCK_EDGE as f64 * map.voxel_size();
        let mut bins: HashMap<[i32; 3], Vec<Place>> = HashMap::new();
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
        let mut places = Vec::new();
        for (submap, t_map_submap) in placed(atlas) {
            let Some(frontier) = self.submaps.get(&submap.id()) else { continue };
            for block in frontier.blocks.values().filter(|block| block.is_known_elsewhere != Some(true)) {
                let position: Point = (t_map_submap * Point3::from(block.position.map(|c| f64::from(c) * voxel))).coords.into();
                if (0..3).all(|k| position[k] >= low[k] && position[k] <= high[k]) {
                    let normal = t_map_submap.rotation * Vector3::from(block.normal.map(f64::from));
                    places.push(Place { position, normal, area: f64::from(block.faces) * voxel * voxel });
                }
            }
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

/// Another submap, as seen from one.
struct Other<'a> {
    field: &'a OccupancyField,
    t_other_submap: Pose,
    /// Where it changed since the last update.
    changes: &'a Changes,
}

impl Other<'_> {
    /// The voxel of the other submap at a place of the submap, finest voxels, with edges of `voxel` metres.
    fn voxel(&self, place: [f32; 3], voxel: f64) -> [i32; 3] {
        let p = self.t_other_submap * Point3::from(place.map(|c| f64::from(c) * voxel));
        <[f64; 3]>::from(p.coords).map(|c| (c / voxel).floor() as i32)
    }
}

/// All submaps of an atlas and their poses, with the one that is being fused.
fn placed(atlas: &Atlas) -> impl Iterator<Item = (&Submap, Pose)> {
    let merging = atlas.merging().map(|merging| (merging.submap, merging.t_map_submap));
    atlas.submaps().iter().map(|submap| (submap, submap.t_map_submap())).chain(merging)
}

/// Joins neighbouring bins: groups of what is in them, in the order of their first bins.
fn connected<T>(mut bins: HashMap<[i32; 3], Vec<T>>) -> Vec<Vec<T>> {
    let mut order: Vec<[i32; 3]> = bins.keys().copied().collect();
    order.sort_unstable();
    let mut left = BinSet::default();
    order.iter().for_each(|bin| left.insert(*bin));
    let mut components = Vec::new();
    let mut stack = Vec::new();
    for first in order {
        let Some(mut component) = bins.remove(&first) else { continue };
        left.remove(first);
        stack.push(first);
        while let Some(bin) = stack.pop() {
            let around = left.around(bin);
            for i in (0..27).filter(|i| around >> i & 1 == 1) {
                let next = [bin[0] + i % 3 - 1, bin[1] + i / 3 % 3 - 1, bin[2] + i / 9 - 1];
                if let Some(places) = bins.remove(&next) {
                    left.remove(next);
                    component.extend(places);
                    stack.push(next);
                }
            }
        }
        components.push(component);
    }
    components
}

/// A set of bins: a bit for each of 4 x 4 x 4, x fastest.
#[derive(Default)]
struct BinSet {
    tiles: HashMap<[i32; 3], u64>,
}

impl BinSet {
    fn bit(bin: [i32; 3]) -> u64 {
        1 << ((bin[0] & 3) + 4 * (bin[1] & 3) + 16 * (bin[2] & 3))
    }

    fn insert(&mut self, bin: [i32; 3]) {
        *self.tiles.entry(bin.map(|c| c >> 2)).or_default() |= Self::bit(bin);
    }

    fn remove(&mut self, bin: [i32; 3]) {
        if let Some(tile) = self.tiles.get_mut(&bin.map(|c| c >> 2)) {
            *tile &= !Self::bit(bin);
        }
    }

    /// Which of the 27 bins in and around a bin are in the set: a bit each, x fastest.
    fn around(&self, bin: [i32; 3]) -> u32 {
        let first = bin.map(|c| (c - 1) >> 2);
        // The tiles around, each looked up once: the next one along an axis only where the bins are in two.
        let mut tiles = [None; 8];
        (0..27).fold(0, |around, i: i32| {
            let next = [bin[0] + i % 3 - 1, bin[1] + i / 3 % 3 - 1, bin[2] + i / 9 - 1];
            let tile = next.map(|c| c >> 2);
            let number = (0..3).fold(0, |number, k| number | usize::from(tile[k] != first[k]) << k);
            let mask = *tiles[number].get_or_insert_with(|| self.tiles.get(&tile).copied().unwrap_or(0));
            around | u32::from(mask & Self::bit(next) != 0) << i
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use voxelastic::settings::FieldKind;
    use voxelastic::{Settings, event::Event, mapper::Mapper};
    use voxelastic_sim::{PoseSource, SimOptions, Simulation};

    /// Groups of bins, each joined with all others that touch it until nothing changes any more.
    fn slow(bins: &[[i32; 3]]) -> Vec<Vec<[i32; 3]>> {
        let touch = |a: &[i32; 3], b: &[i32; 3]| (0..3).all(|k| (a[k] - b[k]).abs() <= 1);
        let mut groups: Vec<Vec<[i32; 3]>> = bins.iter().map(|bin| vec![*bin]).collect();
        loop {
            let pairs = || (0..groups.len()).flat_map(|i| (0..i).map(move |j| (j, i)));
            let Some((j, i)) = pairs().find(|(j, i)| groups[*i].iter().any(|a| groups[*j].iter().any(|b| touch(a, b)))) else { break };
            let group = groups.remove(i);
            groups[j].extend(group);
        }
        groups.iter_mut().for_each(|group| group.sort_unstable());
        groups.sort_unstable();
        groups
    }

    /// Kept up over scans in several submaps and a correction, everything is as the map says and as a new frontier has it.
    #[test]
    fn what_other_submaps_know_is_left_out_after_every_scan() {
        let simulated = |world: &str, scans| Simulation::new(SimOptions { scans: Some(scans), columns: Some(256), ..SimOptions::of(world) }).unwrap();
        let settings =
            Settings { voxel_size: 0.2, max_range: 12.0, field: FieldKind::Occupancy, lambda_odom: 3.0, min_overlap: 1.0, ..Settings::default() };
        let mut mapper = Mapper::new(settings).unwrap();
        let mut frontiers = Frontiers::new(FrontierSettings::default());
        let (mut node, mut known, mut unknown) = (0, 0, 0);
        for (world, scans) in [("room", 3), ("plane", 6), ("room", 3)] {
            for scan in simulated(world, scans).scans(PoseSource::Truth) {
                mapper.handle(Event::Scan(voxelastic::event::Scan { node, ..scan })).unwrap();
                node += 1;
                if node == 7 {
                    let moved = |id: u64| Pose::translation(0.07 * id as f64, 0.0, 0.03) * mapper.pose(id).unwrap();
                    let update = (0..node).map(|id| (id, moved(id))).collect();
                    mapper.handle(Event::PoseUpdate(update)).unwrap();
                }
                let atlas = mapper.atlas();
                frontiers.update(atlas);
                let map = atlas.query();
                for (submap, t_map_submap) in placed(atlas) {
                    for block in frontiers.submaps[&submap.id()].blocks.values() {
                        let probe = t_map_submap * Point3::from(block.probe.map(|c| f64::from(c) * map.voxel_size()));
                        let is_known = map.state(probe.coords.into()) != State::Unknown;
                        assert_eq!(block.is_known_elsewhere, Some(is_known), "scan {node}, submap {}, {block:?}", submap.id());
                        *(if is_known { &mut known } else { &mut unknown }) += 1;
                    }
                }
                let mut anew = Frontiers::new(FrontierSettings::default());
                anew.update(atlas);
                let bounds = [[-20.0; 3], [20.0; 3]];
                assert_eq!(frontiers.clusters(atlas, &map, bounds), anew.clusters(atlas, &map, bounds), "scan {node}");
            }
        }
        assert!(mapper.atlas().submaps().len() > 1 && known > 500 && unknown > 500, "{known} places are known elsewhere, {unknown} are not");
    }

    proptest! {
        #[test]
        fn groups_are_what_touches(bins in prop::collection::btree_set(prop::array::uniform3(-4i32..4), 0..50)) {
            let bins: Vec<[i32; 3]> = bins.into_iter().collect();
            let mut groups = connected(bins.iter().map(|bin| (*bin, vec![*bin])).collect());
            groups.iter_mut().for_each(|group| group.sort_unstable());
            // In the order of their first bins.
            prop_assert_eq!(groups, slow(&bins));
        }
    }
}
