//! The distance field of a submap, in its frame.

use crate::layer::Layer;
use crate::seeds::Seeds;
use crate::targets::{BlockSet, blocks_within};
use voxelastic::atlas::Submap;
use voxelastic::field::occupancy::{Flip, FlipKind, OccupancyField};

/// Distances to obstacles and, if wanted, to everything that is not free.
#[derive(Clone, Debug, Default)]
pub(crate) struct SubmapEsdf {
    /// Revision of what it was made of.
    revision: Option<Revision>,
    pub obstacles: Layer,
    pub not_free: Option<Layer>,
}

/// What a field was made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Revision {
    Occupancy(u64),
    Surfaces(u64),
}

impl SubmapEsdf {
    /// Brings the field up to date; returns the number of blocks recomputed.
    pub fn update(&mut self, submap: &Submap, reach: usize, with_unknown: bool) -> usize {
        if with_unknown && self.not_free.is_none() {
            (self.not_free, self.revision) = (Some(Layer::default()), None);
        }
        let occupancy = submap.occupancy();
        if !occupancy.is_empty() {
            return self.update_from_occupancy(occupancy, reach);
        }
        // The TSDF does not log its changes.
        let revision = Revision::Surfaces(submap.revision());
        if self.revision.replace(revision) == Some(revision) {
            return 0;
        }
        rebuild(&mut self.obstacles, Seeds::Surface(submap.tsdf()), reach)
    }

    fn update_from_occupancy(&mut self, field: &OccupancyField, reach: usize) -> usize {
        let before = self.revision.replace(Revision::Occupancy(field.revision()));
        let flips: Option<Vec<Flip>> = match before {
            Some(Revision::Occupancy(revision)) => field.changes_since(revision).map(|flips| flips.copied().collect()),
            _ => None,
        };
        let update = |layer: &mut Layer, seeds: Seeds<'_>, counts: fn(FlipKind) -> bool| match &flips {
            None => rebuild(layer, seeds, reach),
            Some(flips) => {
                let mut changed = BlockSet::default();
                flips.iter().filter(|flip| counts(flip.kind)).for_each(|flip| add(&mut changed, seeds, flip.key, u32::from(flip.level)));
                layer.update(seeds, &changed, reach)
            }
        };
        let obstacles = update(&mut self.obstacles, Seeds::Occupied(field), |kind| kind.occupied);
        obstacles + self.not_free.as_mut().map_or(0, |layer| update(layer, Seeds::NotFree(field), |kind| kind.free))
    }

    /// Brings the blocks of `wanted` up to date, and no others. `made` has those that are: no other block may be looked up. Returns the number of blocks recomputed.
    pub fn update_near(&mut self, submap: &Submap, reach: usize, with_unknown: bool, wanted: &BlockSet, made: &mut BlockSet) -> usize {
        let occupancy = submap.occupancy();
        let has_occupancy = !occupancy.is_empty();
        if with_unknown && self.not_free.is_none() {
            (self.not_free, self.revision) = (Some(Layer::default()), None);
        }
        let now = if has_occupancy { Revision::Occupancy(occupancy.revision()) } else { Revision::Surfaces(submap.revision()) };
        match self.revision.replace(now) {
            Some(before) if before == now => {}
            Some(Revision::Occupancy(before)) if has_occupancy => match occupancy.changes_since(before) {
                Some(flips) => made.remove(&changed_by(flips, with_unknown).dilated(blocks_within(reach))),
                None => self.keep(&BlockSet::default(), made),
            },
            _ => self.keep(&BlockSet::default(), made),
        }
        let mut missing = wanted.clone();
        missing.remove(made);
        made.extend(&missing);
        let seeds = if has_occupancy { Seeds::Occupied(occupancy) } else { Seeds::Surface(submap.tsdf()) };
        let not_free = self.not_free.as_mut().filter(|_| has_occupancy);
        let count = not_free.map_or(0, |layer| layer.recompute(Seeds::NotFree(occupancy), missing.clone(), reach));
        count + self.obstacles.recompute(seeds, missing, reach)
    }

    /// Removes all blocks that are not in `set`.
    pub fn keep(&mut self, set: &BlockSet, made: &mut BlockSet) {
        *made = set.clone();
        self.obstacles.retain(set);
        self.not_free.iter_mut().for_each(|layer| layer.retain(set));
    }

    pub fn blocks(&self) -> usize {
        self.obstacles.len() + self.not_free.as_ref().map_or(0, Layer::len)
    }

    pub fn bytes(&self) -> usize {
        self.obstacles.bytes() + self.not_free.as_ref().map_or(0, Layer::bytes)
    }
}

/// The blocks in which seeds began or ended.
fn changed_by<'a>(flips: impl Iterator<Item = &'a Flip>, with_unknown: bool) -> BlockSet {
    let mut changed = BlockSet::default();
    for flip in flips {
        if flip.kind.occupied {
            changed.add_octant(flip.key, u32::from(flip.level), false);
        }
        if flip.kind.free && with_unknown {
            changed.add_octant(flip.key, u32::from(flip.level), true);
        }
    }
    changed
}

fn rebuild(layer: &mut Layer, seeds: Seeds<'_>, reach: usize) -> usize {
    let mut changed = BlockSet::default();
    seeds.for_each_octant(|key, level| add(&mut changed, seeds, key, level));
    layer.clear();
    layer.update(seeds, &changed, reach)
}

/// Adds an octant. Within one that became free, or unknown, as a whole nothing is stored but near its faces.
fn add(changed: &mut BlockSet, seeds: Seeds<'_>, key: u64, level: u32) {
    changed.add_octant(key, level, matches!(seeds, Seeds::NotFree(_)));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layer::FAR;
    use std::collections::BTreeMap;
    use voxelastic::atlas::Submap;
    use voxelastic::settings::FieldKind;
    use voxelastic::{Settings, event::Event, mapper::Mapper};
    use voxelastic_sim::{PoseSource, SimOptions, Simulation};

    fn blocks(layer: &Layer) -> BTreeMap<u64, Vec<u16>> {
        layer.iter().map(|(key, distances)| (key, distances.to_vec())).collect()
    }

    /// Whether every block that a layer holds belongs to it, compared with a rebuild.
    fn assert_equals_rebuild(esdf: &SubmapEsdf, submap: &Submap, reach: usize) {
        let mut rebuilt = SubmapEsdf::default();
        rebuilt.update(submap, reach, true);
        assert!(blocks(&esdf.obstacles) == blocks(&rebuilt.obstacles), "distances to obstacles");
        let layer = |esdf: &SubmapEsdf| esdf.not_free.as_ref().map(blocks);
        assert!(layer(esdf) == layer(&rebuilt), "distances to what is not free");
    }

    /// Scans of a room, then of the same place with nothing but its ground, then of the room again: obstacles appear and vanish.
    #[test]
    fn updates_after_every_scan_equal_a_rebuild() {
        let simulated = |world: &str, scans| Simulation::new(SimOptions { scans: Some(scans), columns: Some(256), ..SimOptions::of(world) }).unwrap();
        let settings =
            Settings { voxel_size: 0.15, max_range: 12.0, field: FieldKind::Occupancy, lambda_odom: 1e4, min_overlap: 1.0, ..Settings::default() };
        let mut mapper = Mapper::new(settings).unwrap();
        let (mut esdf, reach, mut node) = (SubmapEsdf::default(), 11, 0);
        let (mut updated, mut whole) = (0, 0);
        for (world, scans) in [("room", 3), ("plane", 7), ("room", 3)] {
            for scan in simulated(world, scans).scans(PoseSource::Truth) {
                mapper.handle(Event::Scan(voxelastic::event::Scan { node, ..scan })).unwrap();
                node += 1;
                let submap = &mapper.atlas().submaps()[0];
                updated += esdf.update(submap, reach, true);
                assert_eq!(esdf.update(submap, reach, true), 0, "nothing changed since");
                whole += SubmapEsdf::default().update(submap, reach, true);
                assert_equals_rebuild(&esdf, submap, reach);
            }
        }
        assert!(updated < whole, "{updated} blocks instead of {whole}");
        let near = esdf.obstacles.iter().flat_map(|(_, d)| d.iter()).filter(|d| **d != FAR).count();
        assert!(near > 100_000, "{near} voxels near obstacles");
    }

    #[test]
    fn threads_change_nothing_and_a_map_of_surfaces_has_a_field_too() {
        let settings = Settings { voxel_size: 0.15, field: FieldKind::Both, ..Settings::default() };
        let mut mapper = Mapper::new(settings).unwrap();
        let room = Simulation::new(SimOptions { scans: Some(2), columns: Some(256), ..SimOptions::of("room") }).unwrap();
        room.scans(PoseSource::Truth).for_each(|scan| assert!(mapper.handle(Event::Scan(scan)).unwrap().is_some()));
        let submap = &mapper.atlas().submaps()[0];
        let fields = [1, 3].map(|threads| {
            let mut esdf = SubmapEsdf::default();
            rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| esdf.update(submap, 9, true));
            blocks(&esdf.obstacles)
        });
        assert!(fields[0] == fields[1]);
        let surfaces = Submap::new(0, 0.15, voxelastic::Pose::identity()).with_fields(submap.tsdf().clone(), OccupancyField::default());
        let mut esdf = SubmapEsdf::default();
        esdf.update(&surfaces, 9, false);
        let zeros = |blocks: &BTreeMap<u64, Vec<u16>>| blocks.values().flatten().filter(|d| **d == 0).count();
        let (of_surfaces, of_occupancy) = (zeros(&blocks(&esdf.obstacles)), zeros(&fields[0]));
        assert!(of_surfaces > of_occupancy / 3 && of_surfaces < of_occupancy * 3, "{of_surfaces} and {of_occupancy} seeds");
    }
}
