//! The frontier of the whole map, kept up while the map grows and bends: what a scan costs does not depend on how large the map is.

use crate::targets::clusters::{FrontierCluster, FrontierSettings, Place};
use crate::targets::frontier::{BlockFrontier, Changes, Known, Part, SubmapFrontier};
use nalgebra::{Point3, Vector3};
use std::collections::{BTreeMap, BTreeSet};
use voxelastic::Pose;
use voxelastic::atlas::{Atlas, Submap, SubmapId};
use voxelastic::field::occupancy::{OccupancyField, State};
use voxelastic::geometry::{Aabb, box_around};
use voxelastic::octree::{BLOCK_EDGE, BLOCK_SHIFT};
use voxelastic::query::AtlasQuery;
use voxelastic_plan::Point;

/// Clusters are made in squares of this edge, metres, again only where something has changed; none extends across a border. The first square is around the origin.
const TILE: f64 = 128.0;

/// What one submap knows of another is looked up again when a correction has moved them against each other by this many voxels, at most where the other is.
const MOVED: f64 = 0.1;

/// The frontier is kept so far outside of the box, too, metres along the axes of the map, and of a submap made anew when corrections have moved it farther. The box is low
/// and wide: most of what a sensor sees is above it and below.
const BEYOND: Point = [2.0, 2.0, 0.5];

/// The square around a place.
type Tile = [i32; 2];

/// The frontier of an atlas in a box, kept up while the map grows and bends.
#[derive(Clone, Debug)]
pub struct Frontiers {
    settings: FrontierSettings,
    /// Corners of the box, map frame, metres.
    bounds: [Point; 2],
    submaps: BTreeMap<SubmapId, Kept>,
    /// Clusters as they were made last.
    tiles: BTreeMap<Tile, Vec<FrontierCluster>>,
    /// Squares in which something has changed since.
    outdated: BTreeSet<Tile>,
    /// Where voxels changed their state in the last update.
    changed: Vec<(Point, f64)>,
}

/// What is kept of a submap.
#[derive(Clone, Debug, Default)]
struct Kept {
    frontier: SubmapFrontier,
    /// Where the submap was when the part of it was chosen of which the frontier is kept.
    chosen_at: Option<Pose>,
    /// Whether that was in the last update.
    is_remade: bool,
    t_map_submap: Option<Pose>,
    /// Box around everything observed and a block more, map frame, metres.
    extent: Aabb,
    /// The other submaps with boxes that overlap this one, and this one's pose in their frames when blocks were looked up in all of them.
    others: Vec<(SubmapId, Pose)>,
    /// Whether anything has changed since the places were collected.
    has_changed: bool,
    /// What is on the frontier and unknown to all submaps.
    places: BTreeMap<Tile, Vec<Place>>,
}

impl Frontiers {
    /// An empty frontier in the box with the corners `bounds`, map frame, metres; infinite where it has no limits.
    pub fn new(settings: FrontierSettings, bounds: [Point; 2]) -> Self {
        let (submaps, tiles, outdated, changed) = Default::default();
        Self { settings, bounds, submaps, tiles, outdated, changed }
    }

    /// Brings the frontier of every submap up to date, as far as it is in the box: only where voxels changed their state since the last update, or, after a correction of
    /// poses, what other submaps know of it. Returns the number of blocks looked at.
    pub fn update(&mut self, atlas: &Atlas) -> usize {
        let all: Vec<(&Submap, Pose)> = atlas.placed().collect();
        let ids: BTreeSet<SubmapId> = all.iter().map(|(submap, _)| submap.id()).collect();
        let outdated = &mut self.outdated;
        self.submaps.retain(|id, kept| {
            let is_there = ids.contains(id);
            if !is_there {
                outdated.extend(kept.places.keys());
            }
            is_there
        });
        self.changed.clear();
        let (mut count, mut changes, mut extents) = (0, Vec::with_capacity(all.len()), Vec::with_capacity(all.len()));
        let block = BLOCK_EDGE as f32 * atlas.voxel_size();
        for (submap, t_map_submap) in &all {
            let kept = self.submaps.entry(submap.id()).or_default();
            let (looked_at, changed) = kept.update(submap, t_map_submap, &self.bounds);
            count += looked_at;
            self.changed.extend(changed.balls(f64::from(block)).map(|(centre, radius)| (in_map(t_map_submap, centre), radius)));
            if !changed.is_empty() || kept.t_map_submap != Some(*t_map_submap) {
                kept.extent = larger(submap.query().bounds_in(t_map_submap), block);
                kept.has_changed = true;
            }
            changes.push(changed);
            extents.push(kept.extent);
        }
        for (k, (submap, t_map_submap)) in all.iter().enumerate() {
            let Some(kept) = self.submaps.get_mut(&submap.id()) else { continue };
            let near: Vec<usize> = (0..all.len()).filter(|other| *other != k && overlap(&extents[k], &extents[*other])).collect();
            let apart = |other: &usize| (all[*other].0.id(), all[*other].1.inverse() * t_map_submap);
            let mut others: Vec<(SubmapId, Pose)> = near.iter().map(apart).collect();
            let lost: Vec<SubmapId> = kept.others.iter().map(|(id, _)| *id).filter(|id| !others.iter().any(|(near, _)| near == id)).collect();
            let most = MOVED * f64::from(atlas.voxel_size());
            let is_new: Vec<bool> = others.iter_mut().map(|other| kept.is_moved(other, submap, most)).collect();
            (kept.t_map_submap, kept.others) = (Some(*t_map_submap), others);
            let have_changed = || !changes[k].is_empty() || near.iter().any(|other| !changes[*other].is_empty());
            if !(kept.is_remade || have_changed() || !lost.is_empty() || is_new.contains(&true)) {
                continue;
            }
            let other = |(&other, is_new): (&usize, bool)| {
                let t_other_submap = all[other].1.inverse() * t_map_submap;
                Other {
                    id: all[other].0.id(),
                    field: all[other].0.occupancy(),
                    t_other_submap,
                    changes: &changes[other],
                    changed_box: box_around(&t_other_submap.inverse(), changes[other].bounds(f64::from(block))),
                    is_new,
                }
            };
            let others: Vec<Other<'_>> = near.iter().zip(is_new).map(other).collect();
            kept.has_changed |= look_up(&mut kept.frontier, &others, &lost, f64::from(atlas.voxel_size()));
        }
        count
    }

    /// Balls around everything that changed its state in the last update: centres in the map frame and radii, metres.
    pub(crate) fn changed(&self) -> &[(Point, f64)] {
        &self.changed
    }

    /// The frontier of the map as it is now, in the box, largest clusters first. A part that another submap has
    /// observed, at the current poses, is left out. The frontier must be up to date; `map` is the query of `atlas`.
    pub fn clusters(&mut self, atlas: &Atlas, map: &AtlasQuery<'_>) -> Vec<FrontierCluster> {
        for (submap, t_map_submap) in atlas.placed() {
            let Some(kept) = self.submaps.get_mut(&submap.id()) else { continue };
            if std::mem::take(&mut kept.has_changed) {
                let places = kept.collect(&t_map_submap, map.voxel_size(), self.bounds);
                let before = std::mem::replace(&mut kept.places, places);
                let tiles = before.keys().chain(kept.places.keys());
                self.outdated.extend(tiles.filter(|tile| before.get(*tile) != kept.places.get(*tile)));
            }
        }
        for tile in std::mem::take(&mut self.outdated) {
            let in_tile = |(submap, _): (&Submap, Pose)| self.submaps.get(&submap.id()).and_then(|kept| kept.places.get(&tile));
            let places: Vec<Place> = atlas.placed().filter_map(in_tile).flatten().copied().collect();
            self.tiles.insert(tile, self.settings.clusters(places, map.voxel_size()));
        }
        self.tiles.retain(|_, clusters| !clusters.is_empty());
        let mut clusters: Vec<FrontierCluster> = self.tiles.values().flatten().copied().collect();
        clusters.sort_by(|a, b| b.area.total_cmp(&a.area).then_with(|| a.centre.partial_cmp(&b.centre).unwrap_or(std::cmp::Ordering::Equal)));
        clusters
    }
}

impl Kept {
    /// Brings the submap's own frontier up to date; returns how many blocks were looked at, and what has changed. Makes it anew if the submap has moved too far.
    fn update(&mut self, submap: &Submap, t_map_submap: &Pose, bounds: &[Point; 2]) -> (usize, Changes) {
        let block = BLOCK_EDGE as f64 * f64::from(submap.voxel_size());
        let [low, high]: [Point; 2] = [std::array::from_fn(|k| bounds[0][k] - BEYOND[k]), std::array::from_fn(|k| bounds[1][k] + BEYOND[k])];
        let part_at = |t_map_submap| Part::new(t_map_submap, [low, high], block);
        let chosen_at = *self.chosen_at.get_or_insert(*t_map_submap);
        let (count, changes) = self.frontier.update(submap.occupancy(), &part_at(chosen_at));
        let has_limits = |k: usize| low[k].is_finite() || high[k].is_finite();
        let has_left = |moved: Vector3<f64>| (0..3).any(|k| has_limits(k) && moved[k].abs() > BEYOND[k]);
        self.is_remade = chosen_at != *t_map_submap && displacements(&chosen_at, t_map_submap, &submap.query().bounds()).any(has_left);
        if self.is_remade {
            (self.chosen_at, self.has_changed) = (Some(*t_map_submap), true);
            self.frontier.remake(submap.occupancy(), &part_at(*t_map_submap));
        }
        (count, changes)
    }

    /// Whether another submap has moved, as seen from anywhere in `submap`, which this is kept of, by more than `most` metres since blocks were looked up in it, or was not
    /// near then. Takes the pose of then if not: what small corrections add up to counts.
    fn is_moved(&self, (id, pose): &mut (SubmapId, Pose), submap: &Submap, most: f64) -> bool {
        // The box takes a look at the whole submap after each change.
        let has_stayed = |before: &Pose| before == pose || displacement(before, pose, &submap.query().bounds()) <= most;
        match self.others.iter().find(|(other, _)| other == id) {
            Some((_, before)) if has_stayed(before) => {
                *pose = *before;
                false
            }
            _ => true,
        }
    }

    /// Everything on the submap's frontier that is in the box and unknown to all submaps.
    fn collect(&self, t_map_submap: &Pose, voxel: f64, [low, high]: [Point; 2]) -> BTreeMap<Tile, Vec<Place>> {
        let mut places: BTreeMap<Tile, Vec<Place>> = BTreeMap::new();
        for block in self.frontier.blocks.values().filter(|block| block.known.is_known() != Some(true)) {
            let position = in_map(t_map_submap, block.position.map(|c| f64::from(c) * voxel));
            if (0..3).all(|k| position[k] >= low[k] && position[k] <= high[k]) {
                let normal = t_map_submap.rotation * Vector3::from(block.normal.map(f64::from));
                let tile = [position[0], position[1]].map(|c| (c / TILE + 0.5).floor() as i32);
                places.entry(tile).or_default().push(Place { position, normal, area: f64::from(block.faces) * voxel * voxel });
            }
        }
        places
    }
}

/// Another submap, as seen from one.
struct Other<'a> {
    id: SubmapId,
    field: &'a OccupancyField,
    t_other_submap: Pose,
    /// Where it changed since the last update.
    changes: &'a Changes,
    /// Corners of a box around them in the frame of the submap that asks, metres.
    changed_box: [Point; 2],
    /// Whether it was not near before, or elsewhere, as seen from the submap.
    is_new: bool,
}

impl Other<'_> {
    /// The voxel of the other submap at a place of the submap, finest voxels, with edges of `voxel` metres.
    fn voxel(&self, place: [f32; 3], voxel: f64) -> [i32; 3] {
        let p = self.t_other_submap * Point3::from(place.map(|c| f64::from(c) * voxel));
        <[f64; 3]>::from(p.coords).map(|c| (c / voxel).floor() as i32)
    }

    /// Whether it knows what is unknown at a block.
    fn knows(&self, block: &BlockFrontier, voxel: f64) -> bool {
        self.field.state_at(self.voxel(block.probe, voxel)) != State::Unknown
    }

    /// Whether it may know more or less of a block than it did at the last update.
    fn is_outdated(&self, block: &BlockFrontier, voxel: f64) -> bool {
        let is_in = |k: usize| (self.changed_box[0][k]..=self.changed_box[1][k]).contains(&(f64::from(block.probe[k]) * voxel));
        let has_changed = || (0..3).all(is_in) && self.changes.has(self.voxel(block.probe, voxel).map(|c| c >> BLOCK_SHIFT));
        self.is_new || !self.changes.is_empty() && has_changed()
    }
}

/// Looks up what others know, of each block in those that may know something else by now, or did before and are `lost`; returns whether anything has changed.
fn look_up(frontier: &mut SubmapFrontier, others: &[Other<'_>], lost: &[SubmapId], voxel: f64) -> bool {
    let changed: Vec<&Other<'_>> = others.iter().filter(|other| other.is_new || !other.changes.is_empty()).collect();
    let mut has_changed = false;
    for block in frontier.blocks.values_mut() {
        let knows = |other: &Other<'_>| other.knows(block, voxel);
        let of_all = || others.iter().find(|other| knows(other)).map(|other| other.id);
        let found = match block.known {
            Known::Unasked => of_all(),
            Known::Nowhere => changed.iter().find(|other| other.is_outdated(block, voxel) && knows(other)).map(|other| other.id),
            // One that was lost and is there again, elsewhere, is new.
            Known::In(id) => match changed.iter().find(|other| other.id == id) {
                Some(other) if other.is_outdated(block, voxel) && !knows(other) => of_all(),
                None if lost.contains(&id) => of_all(),
                _ => Some(id),
            },
        };
        let known = found.map_or(Known::Nowhere, Known::In);
        has_changed |= block.known.is_known() != known.is_known();
        block.known = known;
    }
    has_changed
}

fn in_map(t_map_submap: &Pose, p: Point) -> Point {
    (t_map_submap * Point3::from(p)).coords.into()
}

/// How far the corners of a box are from themselves if it is placed by one pose and by the other, metres. Nothing in it is farther, nor along any axis.
fn displacements(a: &Pose, b: &Pose, bounds: &Aabb) -> impl Iterator<Item = Vector3<f64>> {
    let corner = |i: usize| Point3::from(std::array::from_fn(|k| f64::from(if i >> k & 1 == 0 { bounds.min[k] } else { bounds.max[k] })));
    (0..8).map(corner).map(move |p| a * p - b * p)
}

/// The farthest of them.
fn displacement(a: &Pose, b: &Pose, bounds: &Aabb) -> f64 {
    displacements(a, b, bounds).map(|moved| moved.norm()).fold(0.0, f64::max)
}

/// A box with so many metres more on every side.
fn larger(bounds: Aabb, by: f32) -> Aabb {
    Aabb { min: bounds.min.map(|c| c - by), max: bounds.max.map(|c| c + by) }
}

fn overlap(a: &Aabb, b: &Aabb) -> bool {
    (0..3).all(|k| a.min[k] <= b.max[k] && b.min[k] <= a.max[k])
}

#[cfg(test)]
mod tests {
    use super::*;
    use voxelastic::settings::FieldKind;
    use voxelastic::{Settings, event::Event, mapper::Mapper};
    use voxelastic_sim::{PoseSource, SimOptions, Simulation};

    /// The frontier of everything, made anew, of which only what is in a box is clustered.
    fn of_everything(atlas: &Atlas, bounds: [Point; 2]) -> Vec<FrontierCluster> {
        let mut anew = Frontiers::new(FrontierSettings::default(), [[f64::NEG_INFINITY; 3], [f64::INFINITY; 3]]);
        anew.update(atlas);
        anew.bounds = bounds;
        anew.clusters(atlas, &atlas.query().unwrap())
    }

    /// Kept up in boxes over scans in several submaps and corrections, everything is as the map says and as a new frontier of everything has it.
    #[test]
    fn what_other_submaps_know_is_left_out_after_every_scan() {
        let boxes = [[[-20.0; 3], [20.0; 3]], [[-2.0, -2.0, 1.2], [2.0, 2.0, 1.6]]];
        let [whole, low] = boxes.map(what_others_know_is_left_out);
        assert!(whole.iter().all(|blocks| *blocks > 500), "{whole:?} blocks");
        assert!(low.iter().all(|blocks| *blocks > 100) && 2 * (low[0] + low[1]) < whole[0] + whole[1], "{low:?} of {whole:?} blocks");
    }

    /// Number of blocks that other submaps know and do not, after each scan.
    fn what_others_know_is_left_out(bounds: [Point; 2]) -> [usize; 2] {
        let simulated = |world: &str, scans| Simulation::new(SimOptions { scans: Some(scans), columns: Some(256), ..SimOptions::of(world) }).unwrap();
        let settings =
            Settings { voxel_size: 0.2, max_range: 12.0, field: FieldKind::Occupancy, lambda_odom: 3.0, min_overlap: 1.0, ..Settings::default() };
        let mut mapper = Mapper::new(settings).unwrap();
        let mut frontiers = Frontiers::new(FrontierSettings::default(), bounds);
        let (mut node, mut known, mut unknown, mut remade) = (0, 0, 0, 0);
        for (world, scans) in [("room", 3), ("plane", 6), ("room", 3)] {
            for scan in simulated(world, scans).scans(PoseSource::Truth) {
                mapper.handle(Event::Scan(voxelastic::event::Scan { node, ..scan })).unwrap();
                node += 1;
                // A little, and farther than the frontier is kept outside of the box.
                let corrections = [(7, 0.03), (9, -2.7), (11, 2.8)];
                if let Some((_, up)) = corrections.into_iter().find(|(at, _)| *at == node) {
                    let moved = |id: u64| Pose::translation(0.07 * id as f64, 0.0, up) * mapper.pose(id).unwrap();
                    let update = (0..node).map(|id| (id, moved(id))).collect();
                    mapper.handle(Event::PoseUpdate(update)).unwrap();
                }
                let atlas = mapper.atlas();
                let places = |frontiers: &Frontiers| frontiers.submaps.iter().map(|(id, kept)| (*id, kept.chosen_at)).collect::<BTreeMap<_, _>>();
                let before = places(&frontiers);
                frontiers.update(atlas);
                let after = places(&frontiers);
                remade += before.iter().filter(|(id, place)| after.get(*id).is_some_and(|now| now != *place)).count();
                let map = atlas.query().unwrap();
                for (submap, t_map_submap) in atlas.placed() {
                    for block in frontiers.submaps[&submap.id()].frontier.blocks.values() {
                        let probe = t_map_submap * Point3::from(block.probe.map(|c| f64::from(c) * map.voxel_size()));
                        let is_known = map.state(probe.coords.into()) != State::Unknown;
                        assert_eq!(block.known.is_known(), Some(is_known), "scan {node}, submap {}, {block:?}", submap.id());
                        *(if is_known { &mut known } else { &mut unknown }) += 1;
                    }
                }
                assert_eq!(frontiers.clusters(atlas, &map), of_everything(atlas, bounds), "scan {node}");
            }
        }
        assert!(mapper.atlas().submaps().len() > 1 && remade > 2, "{remade} made anew");
        [known, unknown]
    }

    #[test]
    fn only_submaps_that_move_against_each_other_are_asked_again() {
        let simulation = Simulation::new(SimOptions { scans: Some(6), columns: Some(256), ..SimOptions::of("plane") }).unwrap();
        let settings =
            Settings { voxel_size: 0.2, max_range: 12.0, field: FieldKind::Occupancy, lambda_odom: 3.0, update_distance: 0.0, ..Settings::default() };
        let mut mapper = Mapper::new(settings).unwrap();
        for scan in simulation.scans(PoseSource::Truth) {
            mapper.handle(Event::Scan(scan)).unwrap();
        }
        let mut frontiers = Frontiers::new(FrontierSettings::default(), [[f64::NEG_INFINITY; 3], [f64::INFINITY; 3]]);
        frontiers.update(mapper.atlas());
        fn blocks(frontiers: &mut Frontiers) -> impl Iterator<Item = &mut BlockFrontier> {
            frontiers.submaps.values_mut().flat_map(|kept| kept.frontier.blocks.values_mut())
        }
        // Forgets what the submaps know of each other, moves them, and counts what is known then.
        let mut known_after = |moved: &dyn Fn(u64) -> Pose| {
            let update = (0..6).map(|id| (id, moved(id) * mapper.pose(id).unwrap())).collect();
            mapper.handle(Event::PoseUpdate(update)).unwrap();
            blocks(&mut frontiers).for_each(|block| block.known = Known::Nowhere);
            frontiers.update(mapper.atlas());
            blocks(&mut frontiers).filter(|block| block.known.is_known() == Some(true)).count()
        };
        let turned = Pose::new(Vector3::new(4.0, -2.0, 0.5), Vector3::new(0.0, 0.0, 0.3));
        assert_eq!(known_after(&|_| turned), 0, "all together");
        // A millimetre more each time, until it is a tenth of a voxel of 20 cm.
        let known: Vec<usize> = (0..30).map(|_| known_after(&|id| Pose::translation(0.0, 0.0, 1e-3 * id as f64))).collect();
        let asked: Vec<usize> = (0..30).filter(|k| known[*k] > 0).collect();
        assert!(asked.first().is_some_and(|first| (1..20).contains(first)), "{known:?}");
    }

    #[test]
    fn nothing_in_a_box_is_displaced_more_than_its_corners() {
        let bounds = Aabb { min: [-1.0, -2.0, 0.0], max: [3.0, 4.0, 0.5] };
        let at = |x: f64, yaw: f64| Pose::new(Vector3::new(x, 0.0, 0.0), Vector3::new(0.0, 0.0, yaw));
        assert_eq!(displacement(&at(1.0, 0.2), &at(1.0, 0.2), &bounds), 0.0);
        assert!((displacement(&at(1.0, 0.2), &at(1.3, 0.2), &bounds) - 0.3).abs() < 1e-6);
        // Turned by 0.1 around a place from which the farthest corner is 5 m away, along the ground.
        assert!((displacement(&at(0.0, 0.0), &at(0.0, 0.1), &bounds) - 2.0 * 5.0 * 0.05f64.sin()).abs() < 1e-6);
    }
}
